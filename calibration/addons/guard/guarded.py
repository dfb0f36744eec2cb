"""What is checked: the accepted calibrations, their reference and a recording; and the methods that check it."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calibration.addons.guard.features import REFERENCE_FILE, KeptCamera, read_reference
from calibration.addons.guard.fixed_check import METHOD, check_fixed_camera
from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.recording import (
    CameraImages,
    camera_named,
    is_bag,
    no_such_camera,
    open_recordings,
    path_of_recording,
)
from calibration.addons.guard.witness.moving_frames import checks_of_bag
from calibration.addons.guard.witness.plane_map import map_checks_of_bag
from calibration.base import InputError, did_you_mean
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.document import read_baseline


@dataclass(frozen=True, eq=False)
class Guarded:
    """A system, and a recording of it."""

    name: str
    accepted: CalibrationDocument
    kept: tuple[KeptCamera, ...]
    """What its fixed cameras saw when it was accepted."""
    recordings: tuple[str, ...]
    """As they were given, see `open_recordings`."""
    cameras: dict[str, CameraImages]
    """Images in them, by the names that they have there."""


Told = Mapping[str, SensorCheck]
"""What other methods say of sensors."""
Method = Callable[[Guarded, Told], Iterable[SensorCheck]]
"""Checks the sensors of a system of which it can tell something; raises an `InputError` for a wrong recording."""


def fixed_cameras(guarded: Guarded, _: Told) -> Iterable[SensorCheck]:
    """Check the cameras that have a reference.

    Raises:
        InputError: the recording lacks one, or has images of another size, or the reference is of another calibration.
    """
    for kept in guarded.kept:
        images = camera_named(guarded.cameras, kept.sensor, kept.place, len(guarded.kept))
        if images is None:
            raise InputError(f"{guarded.recordings[0]}: {no_such_camera(guarded.cameras, kept.sensor)}")
        yield check_fixed_camera(kept, images)


def moving_cameras(guarded: Guarded, told: Told) -> Iterable[SensorCheck]:
    """Check the cameras of bags by the motion that carries them, by each other, or by a LiDAR.

    Raises:
        InputError: a bag cannot be read.
    """
    for path in map(path_of_recording, guarded.recordings):
        if is_bag(path):
            yield from checks_of_bag(path, guarded.accepted, told)


def moving_lidars(guarded: Guarded, _: Told) -> Iterable[SensorCheck]:
    """Check the LiDARs of bags by the crispness of their map.

    Raises:
        InputError: a bag cannot be read.
    """
    for path in map(path_of_recording, guarded.recordings):
        if is_bag(path):
            yield from map_checks_of_bag(path, guarded.accepted)


METHODS: tuple[Method, ...] = (fixed_cameras, moving_lidars, moving_cameras)
"""Of several that check a sensor the first counts that can tell."""


def guarded_systems(baseline: Path, recordings: Sequence[str], systems: Sequence[str], rate: float) -> list[Guarded]:
    """Read what is checked.

    Args:
        baseline: file of the accepted calibrations, with the reference beside it.
        recordings: bags, videos, folders of images.
        systems: only these; empty for all.
        rate: images a second of folders of images.

    Raises:
        InputError: a file or a recording cannot be read, or the reference is of another calibration.
    """
    accepted = read_baseline(baseline)
    if accepted is None:
        raise InputError(f"{baseline}: found no such file, expected accepted calibrations: calibration accept")
    for name in systems:
        if name not in accepted.systems:
            near, known = did_you_mean(name, accepted.systems), ", ".join(accepted.systems)
            raise InputError(f"{baseline}: found no system '{name}'{near} (found: {known})")
    path = baseline.with_name(REFERENCE_FILE)
    reference = read_reference(path)
    kept = reference.cameras if reference else ()
    for each in kept:
        own = accepted.systems.get(each.system)
        if own is None or own.data != each.data:
            what = "is not in the baseline" if own is None else "has been accepted anew since"
            raise InputError(
                f"{path}: '{each.sensor}' of '{each.system}' {what}, expected a reference of what is accepted: "
                "calibration accept --reference"
            )
    if not recordings:
        raise InputError("found no recording, expected a bag, a video or a folder of images")
    cameras = open_recordings(recordings, rate)
    return [
        Guarded(name, document, tuple(each for each in kept if each.system == name), tuple(recordings), cameras)
        for name, document in accepted.systems.items()
        if not systems or name in systems
    ]


def check_systems(guarded: Sequence[Guarded], baseline: Path) -> dict[str, tuple[SensorCheck, ...]]:
    """Check the sensors of systems, by system; of those that no method can check, nothing is said.

    Raises:
        InputError: a recording is wrong, or no method can check any sensor.
    """
    found: dict[str, tuple[SensorCheck, ...]] = {}
    for system in guarded:
        checks: dict[str, SensorCheck] = {}
        for method in METHODS:
            for check in method(system, checks):
                known = checks.setdefault(check.sensor, check)
                if known.outcome == "cannot-tell" != check.outcome:
                    checks[check.sensor] = check
        if checks:
            found[system.name] = tuple(checks.values())
    if not found:
        raise InputError(
            f"{baseline.with_name(REFERENCE_FILE)}: found no reference of a camera, expected one that is kept where "
            f"nothing moves: calibration accept --reference RECORDING (method: {METHOD})"
        )
    return found
