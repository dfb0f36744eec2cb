"""Whether a bundle is accepted on this robot: what it is, who signed it, how it was judged, how old it is, whose.

And what is in use compared with it: each transform and each camera of it, in each file that has it.
"""

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from calibration.addons.delivery.attestation import SignedStatement, verify_attestation
from calibration.addons.delivery.destinations import FetchedBundle
from calibration.addons.delivery.in_use import InUse, Pose, UsedCamera, UsedTransform, distance_of_poses, pose_of
from calibration.addons.delivery.manifest import (
    MANIFEST_FILE,
    BundledCamera,
    BundledFile,
    BundledSystem,
    BundledTransform,
    Manifest,
    RefusedBundleError,
    parse_manifest,
    unpack_files,
    version_order,
)
from calibration.addons.delivery.results import DifferenceInUse
from calibration.base import InputError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

SECONDS_OF_DAY = 86400.0
MAX_CLOCK_ERROR = SECONDS_OF_DAY
"""Seconds that a bundle may be younger than this machine's clock says."""


@dataclass(frozen=True, kw_only=True)
class Expectations:
    """What is expected of a bundle."""

    keys: "Mapping[str, Ed25519PublicKey]" = field(default_factory=dict)
    """Trusted public keys by their ids; none if it need not be signed."""
    serial: str | None = None
    description: str | None = None
    """SHA-256 of this robot's description."""
    max_age: float | None = None
    """Seconds."""
    at_least: str | None = None
    """Smallest version."""
    marked: bool = False
    """Whether systems may be marked."""
    now: Callable[[], float]
    """The present time, seconds since 1970."""


@dataclass(frozen=True, kw_only=True)
class CheckedBundle:
    """A bundle that was checked; what is not authentic is not parsed."""

    digest: str
    manifest: Manifest | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    signed_by: str | None = None
    reasons: tuple[str, ...] = ()
    """Why it is refused; empty if it is accepted."""
    warnings: tuple[str, ...] = ()


def check_bundle(fetched: FetchedBundle, expected: Expectations) -> CheckedBundle:
    """Check a bundle: first its signature, then its files, then what its manifest says."""
    digest = hashlib.sha256(fetched.content).hexdigest()
    statement = None
    try:
        if expected.keys:
            statement = verify_attestation(fetched.attestation, digest, expected.keys)
        files = unpack_files(fetched.content)
        manifest = _listed_files(files)
    except RefusedBundleError as error:
        return CheckedBundle(digest=digest, signed_by=statement.signer if statement else None, reasons=(str(error),))
    return CheckedBundle(
        digest=digest,
        manifest=manifest,
        files=files,
        signed_by=statement.signer if statement else None,
        reasons=tuple(_reasons(manifest, statement, files, expected)),
        warnings=tuple(_warnings(manifest, statement)),
    )


def _listed_files(files: Mapping[str, bytes]) -> Manifest:
    """Return the manifest of files that are those that it lists."""
    if MANIFEST_FILE not in files:
        raise RefusedBundleError(f"it has no {MANIFEST_FILE}")
    try:
        manifest = parse_manifest(files[MANIFEST_FILE], MANIFEST_FILE)
    except InputError as error:
        raise RefusedBundleError(str(error)) from None
    there = {path: content for path, content in files.items() if path != MANIFEST_FILE}
    listed = {each.path: each for each in manifest.files}
    if strange := sorted(there.keys() ^ listed.keys()):
        found = "it is not there" if strange[0] in listed else "its manifest does not list it"
        raise RefusedBundleError(f"its file '{strange[0]}': {found}")
    for path, content in there.items():
        own = BundledFile(path, len(content), hashlib.sha256(content).hexdigest())
        if listed[path] != own:
            raise RefusedBundleError(f"its file '{path}' has another content than its manifest says")
    return manifest


def _reasons(
    manifest: Manifest, statement: SignedStatement | None, files: Mapping[str, bytes], expected: Expectations
) -> Iterator[str]:
    if not expected.marked:
        yield from (f"{mark}; bundled although: {manifest.although}" for mark in manifest.marks)
        for system in manifest.systems:
            if system.verdict == "fail" and not system.marks:
                yield f"{system.name}: fail: {'; '.join(system.reasons[:1])}"
        if statement is not None and statement.result == "FAILED" and not manifest.marks:
            yield "its attestation says FAILED, and its manifest does not"
    if not manifest.systems:
        yield "it has no system"
    if expected.serial is not None and manifest.serial != expected.serial:
        yield f"it is of another robot: found the serial number {manifest.serial!r}, expected {expected.serial!r}"
    if expected.description is not None and expected.description not in _descriptions(manifest, files):
        yield f"it is of another robot: found no description of sha256 {expected.description[:16]}..."
    if expected.at_least is not None and version_order(manifest.version) < version_order(expected.at_least):
        yield f"it is an older one: found version {manifest.version}, expected at least {expected.at_least}"
    if expected.max_age is not None:
        age = expected.now() - manifest.made
        days = f"{age / SECONDS_OF_DAY:.1f} days"
        if age > expected.max_age:
            yield f"it has expired: found an age of {days}, expected at most {expected.max_age / SECONDS_OF_DAY:g}"
        elif age < -MAX_CLOCK_ERROR:
            yield f"it is of the future: found an age of {days}: is the clock of this machine right?"


def _descriptions(manifest: Manifest, files: Mapping[str, bytes]) -> set[str]:
    """Return the hashes of the descriptions that were calibrated, and of those with calibrated origins."""
    given = {system.description for system in manifest.systems if system.description}
    urdfs = (content for path, content in files.items() if path.endswith(".urdf"))
    return given | {hashlib.sha256(content).hexdigest() for content in urdfs}


def _warnings(manifest: Manifest, statement: SignedStatement | None) -> Iterator[str]:
    if statement is None:
        yield "its signature is not checked: it may be from anyone"
    if manifest.uncommitted:
        yield "files differed from the commit when it was made"
    for each in manifest.left_out:
        yield f"{each.name}: not in the bundle: {each.why}"
    for system in manifest.systems:
        if system.verdict == "undecided" and not system.marks:
            yield f"{system.name}: undecided, which its configuration lets pass: {'; '.join(system.reasons[:1])}"
        if system.accepted_although:
            yield f"{system.name}: accepted although it had failed: {system.accepted_although}"
    yield from (f"{mark}; bundled although: {manifest.although}" for mark in manifest.marks)


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
