"""What is in use compared with a bundle: each transform and each camera of it, in each file that has it."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from calibration.addons.delivery.in_use import InUse, Pose, UsedCamera, UsedTransform, distance_of_poses, pose_of
from calibration.addons.delivery.manifest import BundledCamera, BundledSystem, BundledTransform
from calibration.addons.delivery.results import DifferenceInUse

RELATIVE_TOLERANCE = 1e-9
"""Of the numbers of a camera: rounding of the last digits of a double."""
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Tolerance:
    """Largest differences that pass: those of numbers with seven decimals."""

    mm: float = 1e-4
    deg: float = 1e-5


@dataclass(frozen=True)
class ComparedWithUse:
    """Result of a comparison."""

    compared: int
    differences: tuple[DifferenceInUse, ...]
    warnings: tuple[str, ...]
    """What could not be compared."""


def compare_with_use(
    systems: Sequence[BundledSystem], sources: Sequence[InUse], tolerance: Tolerance
) -> ComparedWithUse:
    """Compare all transforms and cameras of systems with what is in use.

    A transform or camera that is in none of the sources of its kind is a difference; without such a source, a warning.
    """
    transforms = [each for system in systems for each in system.transforms]
    cameras = [each for system in systems for each in system.cameras]
    everywhere = _by_child(each for source in sources for each in source.transforms)
    differences: list[DifferenceInUse] = []
    warnings: list[str] = []
    compared = 0
    for expected in transforms:
        able = [each for each in sources if each.transforms and (each.has_joints or not expected.joint)]
        holding = [each for each in able if any(used.child == expected.child for used in each.transforms)]
        for source in holding:
            differences += _differences_of_transform(expected, source, everywhere, transforms, tolerance)
        compared += bool(holding)
        if not able:
            wanted = "a URDF" if expected.joint else "a URDF, launch file or bag"
            warnings.append(f"{expected.child}: its transform is not compared: give {wanted} by --in-use")
        elif not holding:
            differences.append(
                _missing(able, expected.child, f"found no such frame, expected it below {expected.parent}")
            )
    used_cameras = [camera for source in sources for camera in source.cameras]
    named = [(used, _camera_of(used, cameras)) for used in used_cameras]
    for camera in cameras:
        of_camera = [used for used, name in named if name == camera.name]
        for used in of_camera:
            differences += _differences_of_camera(camera, used, cameras)
        compared += bool(of_camera)
        if not used_cameras:
            warnings.append(f"{camera.name}: its intrinsics are not compared: give camera_info or a bag by --in-use")
        elif not of_camera:
            able = [source for source in sources if source.cameras]
            differences.append(_missing(able, camera.name, "found no camera_info of it"))
    return ComparedWithUse(compared, tuple(differences), tuple(warnings))


def _missing(sources: Sequence[InUse], of: str, text: str) -> DifferenceInUse:
    return DifferenceInUse(place=", ".join(source.place for source in sources), of=of, text=text)


def _by_child(transforms: Iterable[UsedTransform]) -> dict[str, list[UsedTransform]]:
    """Return transforms by their children, each once."""
    found: dict[str, list[UsedTransform]] = {}
    for used in dict.fromkeys(transforms):
        found.setdefault(used.child, []).append(used)
    return found


def _differences_of_transform(
    expected: BundledTransform,
    source: InUse,
    everywhere: Mapping[str, Sequence[UsedTransform]],
    others: Sequence[BundledTransform],
    tolerance: Tolerance,
) -> Iterator[DifferenceInUse]:
    own = _by_child(source.transforms)
    by_child = {**everywhere, **own}  # a launch file may hang a sensor on a link of the URDF
    wanted = pose_of([*expected.trans, *expected.quat])
    for used in own[expected.child]:
        pose, top = _pose_below(expected, used, by_child)
        if pose is None:
            text = f"found it below {top}, expected below {expected.parent}"
            yield DifferenceInUse(place=source.place, of=expected.child, text=text)
            continue
        mm, deg = distance_of_poses(wanted, pose)
        if not (mm <= tolerance.mm and deg <= tolerance.deg):  # NaN is a difference too
            yield DifferenceInUse(
                place=source.place,
                of=expected.child,
                text=f"found it {mm:.4g} mm and {deg:.4g} deg off its pose below {expected.parent}"
                f"{_other_of_this_pose(expected, pose, others, tolerance)}",
                mm=mm if math.isfinite(mm) else None,
                deg=deg if math.isfinite(deg) else None,
            )


def _pose_below(
    expected: BundledTransform, used: UsedTransform, by_child: Mapping[str, Sequence[UsedTransform]]
) -> tuple[Pose | None, str]:
    """Return the pose of a transform in use below the expected parent, None if it is not; and the highest frame."""
    if used.moves != expected.joint:
        return None, f"{used.parent}, by a joint that {'moves' if used.moves else 'is fixed'}"
    pose, top, seen = used.pose, used.parent, {used.child}
    while top != expected.parent and top not in seen and not expected.joint:
        seen.add(top)
        above = by_child.get(top, ())
        if len(above) != 1 or above[0].moves:
            return None, used.parent
        pose, top = above[0].pose @ pose, above[0].parent
    return (pose if top == expected.parent else None), used.parent


def _other_of_this_pose(
    expected: BundledTransform, pose: Pose, others: Sequence[BundledTransform], tolerance: Tolerance
) -> str:
    for other in others:
        mm, deg = distance_of_poses(pose_of([*other.trans, *other.quat]), pose)
        if other.child != expected.child and mm <= tolerance.mm and deg <= tolerance.deg:
            return f"; this is the pose of {other.child}: are they exchanged?"
    return ""


def _camera_of(used: UsedCamera, cameras: Sequence[BundledCamera]) -> str | None:
    """Return the name of the camera that intrinsics in use are of: by its name, else its frame, else its topic."""
    if used.name is not None:
        return used.name
    if (of_frame := [camera.name for camera in cameras if camera.frame == used.frame]) and len(of_frame) == 1:
        return of_frame[0]
    parts = used.place.rpartition(", ")[2].split("/")
    return next((camera.name for camera in cameras if camera.name in parts), None)


def _differences_of_camera(
    camera: BundledCamera, used: UsedCamera, others: Sequence[BundledCamera]
) -> Iterator[DifferenceInUse]:
    text = _first_difference(camera, used)
    if text is not None:
        same = [other.name for other in others if other.name != camera.name and _first_difference(other, used) is None]
        hint = f"; these are the intrinsics of {same[0]}: are they exchanged?" if same else ""
        yield DifferenceInUse(place=used.place, of=camera.name, text=f"{text}{hint}")


def _first_difference(camera: BundledCamera, used: UsedCamera) -> str | None:
    K = camera.K
    expected = {
        "width": camera.width,
        "height": camera.height,
        "distortion_model": camera.distortion_model,
        "K": K,
        "D": camera.D,
        "R": _IDENTITY,
        "P": (*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0),
    }
    for key, wanted in expected.items():
        found = used.values[key]
        if not isinstance(wanted, tuple):
            if found != wanted:
                return f"{key}: found {found!r:.80}, expected {wanted!r}"
            continue
        if len(found) != len(wanted):
            return f"{key}: found {len(found)} numbers, expected {len(wanted)}"
        for i, (one, other) in enumerate(zip(found, wanted, strict=True)):
            if not abs(one - other) <= RELATIVE_TOLERANCE * max(1.0, abs(other)):
                return f"{key}[{i}]: found {one!r}, expected {other!r}"
    return None
