"""``check``: whether a sensor has moved since its calibration was accepted: by which methods, and the results."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import click

from calibration.addons.guard import recording
from calibration.addons.guard.features import REFERENCE_FILE, KeptCamera, read_reference
from calibration.addons.guard.fixed_check import METHOD, check_fixed_camera
from calibration.addons.guard.lerobot_check import card_table, check_folder
from calibration.addons.guard.lerobot_episodes import is_dataset
from calibration.addons.guard.outcome import SensorCheck
from calibration.addons.guard.witness.moving_frames import checks_of_bag
from calibration.addons.guard.witness.plane_map import map_checks_of_bag
from calibration.base import ExitCode, InputError, did_you_mean, write_atomically
from calibration.base.records import above, computed, field, record, result
from calibration.ci.report import FILES, Outcome, Report, Table, Verdict, count_of, publish, remove_results, shown
from calibration.ci.workflow import Runner
from calibration.commands.parameters import chosen, record_options
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.document import read_baseline
from calibration.engine.baseline.quality import BASELINE_FILE
from calibration.pipeline.system import Undecided

TITLE = "check"


@dataclass(frozen=True, eq=False)
class Guarded:
    """A system, and a recording of it."""

    name: str
    accepted: CalibrationDocument
    kept: tuple[KeptCamera, ...]
    """What its fixed cameras saw when it was accepted."""
    recordings: tuple[str, ...]
    """As they were given, see `open_recordings`."""
    cameras: dict[str, recording.CameraImages]
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
        images = recording.camera_named(guarded.cameras, kept.sensor, kept.place, len(guarded.kept))
        if images is None:
            raise InputError(f"{guarded.recordings[0]}: {recording.no_such_camera(guarded.cameras, kept.sensor)}")
        yield check_fixed_camera(kept, images)


def moving_cameras(guarded: Guarded, told: Told) -> Iterable[SensorCheck]:
    """Check the cameras of bags by the motion that carries them, by each other, or by a LiDAR.

    Raises:
        InputError: a bag cannot be read.
    """
    for path in map(recording.path_of_recording, guarded.recordings):
        if recording.is_bag(path):
            yield from checks_of_bag(path, guarded.accepted, told)


def moving_lidars(guarded: Guarded, _: Told) -> Iterable[SensorCheck]:
    """Check the LiDARs of bags by the crispness of their map.

    Raises:
        InputError: a bag cannot be read.
    """
    for path in map(recording.path_of_recording, guarded.recordings):
        if recording.is_bag(path):
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
    cameras = recording.open_recordings(recordings, rate)
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


@result(kw_only=True)
class CheckedRecording:
    """Results of check: whether sensors have moved since their calibration was accepted."""

    recording: tuple[str, ...] = field("The recordings.")
    systems: Mapping[str, tuple[SensorCheck, ...]] = field("The sensors of each system.")

    @property
    def named(self) -> dict[str, SensorCheck]:
        """The sensors by name, with that of their system if there are several."""
        several = len(self.systems) > 1
        return {
            f"{system}: {each.sensor}" if several else each.sensor: each
            for system, checks in self.systems.items()
            for each in checks
        }

    @property
    @computed()
    def moved(self) -> int:
        """Number of sensors that have moved, or whose lens has changed."""
        return sum(each.red for each in self.named.values())

    @property
    @computed()
    def untold(self) -> int:
        """Number of sensors of which the recording cannot tell."""
        return sum(each.outcome == "cannot-tell" for each in self.named.values())

    @property
    def verdict(self) -> Verdict:
        """Fail if something has moved; undecided if that cannot be told of a sensor."""
        return "fail" if self.moved else "undecided" if self.untold else "pass"

    @property
    def sentence(self) -> str:
        """The numbers, for the line of the verdict."""
        unmoved = len(self.named) - self.moved - self.untold
        parts = [f"{self.moved} moved"] * bool(self.moved) + [f"{self.untold} that cannot be told"] * bool(self.untold)
        return ", ".join([*parts, f"{unmoved} unmoved"]) + f" of {count_of(len(self.named), 'sensor')}"


def report(results: CheckedRecording, undecided: Undecided, baseline: Path) -> Report:
    """Return the report.

    Args:
        results: the results.
        undecided: what a sensor counts as of which the recording cannot tell.
        baseline: the file of accepted calibrations, for annotations.
    """
    named = results.named
    red = tuple(f"{name}: {each.reason}" for name, each in named.items() if each.red)
    cannot = {name: each for name, each in named.items() if each.outcome == "cannot-tell"}
    untold = tuple(f"{name}: cannot be told: {each.reason}" for name, each in cannot.items())
    return Report(
        title=TITLE,
        verdict="pass" if results.verdict == "undecided" and undecided == "pass" else results.verdict,
        sentence=results.sentence,
        reasons=red,
        undecided=untold,
        places=dict.fromkeys(red, (baseline, 1)),
        results=results,
        blocks=(
            Table(
                ("sensor", "outcome", "rotation", "error bar", "since", "would be seen", "why"),
                tuple(_row(name, each) for name, each in named.items()),
            ),
        ),
        suites={TITLE: [_outcome(name, each) for name, each in named.items()]},
        outputs={"moved": results.moved, "untold": results.untold},
    )


def _row(name: str, each: SensorCheck) -> tuple[str, ...]:
    rotation = " ".join(f"{value:+.3f}" for value in each.rotation_deg or ())
    sigma = max(each.rotation_sigma_deg) if each.rotation_sigma_deg else None
    since = "-" if not each.red else "the begin" if each.since is None else f"{each.since:.1f} s"
    seen = [shown(each.unseen_deg, ".3f", "deg", ""), shown(each.unseen_mm, ".1f", "mm", "")]
    return (
        name,
        each.outcome.replace("-", " "),
        f"{rotation} deg" if rotation else "-",
        shown(sigma, ".3f", "deg"),
        since,
        ", ".join(filter(None, seen)) or "-",
        each.reason,
    )


def _outcome(name: str, each: SensorCheck) -> Outcome:
    untold = each.outcome == "cannot-tell"
    return Outcome(
        name=name, group=TITLE, reasons=(each.reason,) if each.red else (), skipped=each.reason if untold else None
    )


@record(kw_only=True)
class CheckSettings:
    """Inputs of ``check``."""

    recording: tuple[str, ...] = field(
        "Bags (.bag, .db3, .mcap, a folder), videos, or folders of images; SENSOR=PATH where it is one sensor's.",
        default=(),
    )
    baseline: Path = field(
        f"File with the accepted calibrations, and the reference beside it ({BASELINE_FILE}).",
        default=Path(BASELINE_FILE),
    )
    systems: tuple[str, ...] = field("Only these systems (all).", default=())
    rate: Annotated[float, above(0, 1000)] = field(
        "Images a second of folders of images, which have no times (1).", default=1.0
    )
    undecided: Undecided = field(
        "What a sensor counts as of which the recording cannot tell: fail (exit code 1) or pass (fail).", default="fail"
    )
    card: Path | None = field(
        "File for a table in Markdown, for the card of a dataset of LeRobot or DROID.", default=None
    )
    annotate: bool = field(
        "Whether meta/calibration.json of a dataset is written: its accepted cameras, and what was found.",
        default=False,
    )
    output: Path | None = field("Folder for results.json, junit.xml and summary.md.", default=None)


def check(settings: CheckSettings, runner: Runner) -> ExitCode:
    """Check a recording, and report.

    Raises:
        InputError: the baseline, the reference or the recording is wrong.
        InfrastructureError: a library is not installed, or a result cannot be written.
    """
    if settings.output is not None:
        remove_results(settings.output, FILES)
    results = CheckedRecording(recording=settings.recording, systems=_checked(settings))
    if settings.card is not None:
        write_atomically(settings.card, card_table(results.systems))
    found = report(results, settings.undecided, settings.baseline)
    publish(found, runner, settings.output)
    return found.exit_code


def _checked(settings: CheckSettings) -> Mapping[str, tuple[SensorCheck, ...]]:
    """Return what is said of the sensors of each system, or of each episode of a dataset."""
    datasets = [path for each in settings.recording if is_dataset(path := Path(each))]
    if datasets:
        if len(settings.recording) > 1:
            raise InputError(f"{datasets[0]}: found a dataset among other recordings, expected it alone")
        return check_folder(datasets[0], settings.baseline, settings.annotate)
    if settings.card is not None or settings.annotate:
        raise InputError("found 'card' or 'annotate', expected the folder of a dataset, with meta/info.json")
    guarded = guarded_systems(settings.baseline, settings.recording, settings.systems, settings.rate)
    return check_systems(guarded, settings.baseline)


@click.command(TITLE)
@click.argument("recordings", nargs=-1)
@record_options(CheckSettings)
def command(recordings: tuple[str, ...], **options: Any) -> ExitCode:
    """Check by RECORDINGS whether a sensor has moved since its calibration was accepted; exit code 1 if one has.

    No board is needed, and nothing is calibrated. Of fixed cameras the still scene is compared with the reference that
    accept --reference keeps.
    """
    options["recording"] = (*recordings, *(options.get("recording") or ()))
    return check(chosen(CheckSettings, options), Runner.from_environment(os.environ))
