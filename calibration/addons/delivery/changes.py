"""What differs between two bundles of a robot: the next version that follows from it, the changelog, and delivery.

A delivery to several destinations is staged at all of them before anything is seen.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

from calibration.addons.delivery.bundling import Bundle
from calibration.addons.delivery.checking import Expectations, check_bundle
from calibration.addons.delivery.destinations import Delivery, Destination, FetchedBundle
from calibration.addons.delivery.manifest import BundledSystem, Manifest, RefusedBundleError, version_order
from calibration.base import CalibrationError, InputError, escape_markdown, markdown_table, parse_json_of
from calibration.base.records import read
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.comparison import compare
from calibration.engine.baseline.quality import SameData
from calibration.engine.baseline.verdict import exceeds, size_of_change
from calibration.pipeline.stages import CALIBRATION_FILE, ExportedCalibration

Level = Literal["none", "patch", "minor", "major"]
FIRST_VERSION = "1.0.0"


@dataclass(frozen=True)
class BundleContents:
    """A bundle that was read."""

    fetched: FetchedBundle
    manifest: Manifest
    calibrations: Mapping[str, CalibrationDocument]
    """By system; of other software there may be none."""


def read_contents(fetched: FetchedBundle) -> BundleContents:
    """Read a bundle, whoever has made it.

    Raises:
        InputError: it is no bundle.
    """
    checked = check_bundle(fetched, Expectations(marked=True, now=lambda: 0.0))
    if checked.manifest is None:
        raise InputError(f"{fetched.where}: {checked.reasons[0]}")
    calibrations = {}
    for system in checked.manifest.systems:
        path = f"{system.name}/{CALIBRATION_FILE}"
        if (content := checked.files.get(path)) is not None:
            where = f"{fetched.where}: {path}"
            document = parse_json_of(content, where, "a calibration")
            calibrations[system.name] = read(ExportedCalibration, document, where).calibration
    return BundleContents(fetched, checked.manifest, calibrations)


@dataclass(frozen=True)
class Change:
    """What has changed about one sensor, parameter or part of a bundle."""

    of: str
    text: str
    level: Level


def changes_between(before: BundleContents, now: BundleContents, same_data: SameData) -> list[Change]:
    """Return the changes of a bundle: the largest decides on the version.

    Major: sensors, frames, cameras or files are not what they were. Minor: a sensor has moved significantly, on the
    same data by more than the tolerances. Patch: anything else that a robot has other files for.

    Raises:
        RefusedBundleError: the bundles are of different robots.
    """
    of_before, of_now = ((each.manifest.name, each.manifest.serial) for each in (before, now))
    if of_before != of_now:
        raise RefusedBundleError(
            f"it is of {' '.join(filter(None, of_before))}, not of {' '.join(filter(None, of_now))}"
        )
    found = list(_other_parts(before.manifest, now.manifest))
    for system in now.manifest.systems:
        earlier = next((each for each in before.manifest.systems if each.name == system.name), None)
        if earlier is not None:
            found += _changes_of_system(earlier, system, before.calibrations, now.calibrations, same_data)
    if not found and _differs_beside_numbers(before.manifest, now.manifest):
        found.append(Change("files", "of other content", "patch"))
    return found


def level_of(changes: list[Change]) -> Level:
    """Return the largest level; none if nothing has changed for the robot."""
    levels: list[Level] = ["major", "minor", "patch"]
    return next((level for level in levels if any(each.level == level for each in changes)), "none")


def next_version(version: str, level: Level) -> str:
    """Return the version that follows: 1.4.2 to 1.4.3, 1.5.0 or 2.0.0."""
    major, minor, patch = (*map(int, version.split(".")), 0, 0)[:3]
    if level == "major":
        return f"{major + 1}.0.0"
    return f"{major}.{minor + 1}.0" if level == "minor" else f"{major}.{minor}.{patch + 1}"


def changelog_text(manifest: Manifest, before: Manifest | None, changes: list[Change]) -> str:
    """Return the changelog of a bundle as Markdown: by how much each sensor has moved since an earlier one."""
    commit = f", commit {manifest.commit}" if manifest.commit else ""
    parts = [f"## {escape_markdown(f'{manifest.name} {manifest.version}{commit}')}\n"]
    if before is None:
        parts.append("The first one that is delivered here.\n")
    else:
        since = f"{level_of(changes)} change since {before.version}"
        parts.append(f"{escape_markdown(since)}{': nothing has moved' if not changes else ''}\n")
        rows = [(each.of, each.text, each.level) for each in changes]
        parts.append(markdown_table(("What", "Change", ""), rows) if rows else "")
    return "\n".join(parts)


def _other_parts(before: Manifest, now: Manifest) -> Iterator[Change]:
    """Yield what one of two bundles has and the other has not; a format of files that came is no break."""
    old, new = set(_parts_of(before)), set(_parts_of(now))
    for part in sorted(old - new):
        yield Change(part, "removed", "major")
    for part in sorted(new - old):
        yield Change(part, "added", "major")
    files, now_files = ({each.path for each in manifest.files} for manifest in (before, now))
    yield from (Change(path, "removed", "major") for path in sorted(files - now_files))
    yield from (Change(path, "added", "minor") for path in sorted(now_files - files))


def _parts_of(manifest: Manifest) -> Iterator[str]:
    for system in manifest.systems:
        yield f"system {system.name}"
        for each in system.transforms:
            kind = "joint" if each.joint else "transform"
            yield f"{system.name}: {kind} {each.parent} to {each.child}"
        for camera in system.cameras:
            size = f"{camera.width}x{camera.height}"
            yield f"{system.name}: camera {camera.name}, {camera.frame}, {size}, {camera.distortion_model}"


def _changes_of_system(
    before: BundledSystem,
    now: BundledSystem,
    old: Mapping[str, CalibrationDocument],
    new: Mapping[str, CalibrationDocument],
    same_data: SameData,
) -> Iterator[Change]:
    if before.name not in old or now.name not in new:
        if before.transforms != now.transforms or before.cameras != now.cameras:
            yield Change(now.name, "moved, with no error bars to compare with", "minor")
        return
    comparison = compare(old[before.name], new[now.name])
    for change in comparison.changes:
        if change.kind in ("added", "removed"):
            yield Change(f"{now.name}: {change.name}", change.kind, "minor")
        elif comparison.same_data and exceeds(change, same_data):
            yield Change(f"{now.name}: {change.name}", f"{size_of_change(change)}, on the same data", "minor")
        elif not comparison.same_data and change.p < comparison.significance:
            yield Change(f"{now.name}: {change.name}", size_of_change(change), "minor")
        elif not comparison.same_data or comparison.other_inputs:  # more than the rounding of another machine
            yield Change(f"{now.name}: {change.name}", f"within its error bars: {size_of_change(change)}", "patch")


def _differs_beside_numbers(before: Manifest, now: Manifest) -> bool:
    """Whether a robot would see another bundle, apart from the last digits of numbers, the commit and the time."""
    return [(each.verdict, each.reasons, each.description, each.accepted_although) for each in before.systems] != [
        (each.verdict, each.reasons, each.description, each.accepted_although) for each in now.systems
    ]


@dataclass(frozen=True)
class DeliveredBundle:
    """What was delivered, and where."""

    contents: BundleContents
    level: Level
    """By how much it differs from what was delivered before; none if it is that bundle."""
    to: tuple[str, ...]
    """The destinations that it was delivered to; those that had it are left out."""
    changelog: str
    later: bool = False
    """Whether a later commit has been delivered already, and therefore nothing was."""


def deliver_bundle(
    bundle: Bundle,
    destinations: Sequence[Destination],
    version: str | None,
    same_data: SameData,
    sign: Callable[[Bundle], bytes | None],
) -> DeliveredBundle:
    """Deliver a bundle, with the version that follows from what changed since the last one.

    What has not changed keeps its version and its bytes; destinations without them get these.

    Args:
        bundle: the bundle, of any version.
        destinations: in the order in which they show it.
        version: its version; None for the one that follows.
        same_data: tolerances of a result on the same data.
        sign: writes a bundle, and returns its attestation.

    Raises:
        InputError: a destination has other things than deliveries of this robot, or does not allow it.
        InfrastructureError: a destination cannot be reached, or another delivery was faster.
    """
    earlier = [_last_contents(destination) for destination in destinations]
    last = max((each for each in earlier if each), key=lambda each: version_order(each.manifest.version), default=None)
    now = read_contents(FetchedBundle("bundle", bundle.content, None))
    level: Level = "major" if last is None else level_of(_changes(last, now, same_data))
    if last is not None and level != "none" and now.manifest.made < last.manifest.made:
        return DeliveredBundle(last, "none", (), "", later=True)
    if last is None or level != "none":
        chosen = version or (FIRST_VERSION if last is None else next_version(last.manifest.version, level))
        if last is not None and version_order(chosen) <= version_order(last.manifest.version):
            raise InputError(f"version: found {chosen}, expected a larger one than {last.manifest.version}, the last")
        versioned = bundle.with_version(chosen)
        last = read_contents(FetchedBundle("bundle", versioned.content, sign(versioned)))
    content = last.fetched.content
    lacking = [
        (destination, before)
        for destination, before in zip(destinations, earlier, strict=True)
        if before is None or before.fetched.content != content
    ]
    changelogs = [
        changelog_text(last.manifest, None, [])
        if before is None
        else changelog_text(last.manifest, before.manifest, _changes(before, last, same_data))
        for _, before in lacking
    ]
    deliveries = [Delivery(last.manifest, content, last.fetched.attestation, each) for each in changelogs]
    _deliver_to_all([destination for destination, _ in lacking], deliveries)
    return DeliveredBundle(last, level, tuple(each.name for each, _ in lacking), changelogs[0] if lacking else "")


def _last_contents(destination: Destination) -> BundleContents | None:
    found = destination.last()
    return None if found is None else read_contents(found)


def _changes(before: BundleContents, now: BundleContents, same_data: SameData) -> list[Change]:
    try:
        return changes_between(before, now, same_data)
    except RefusedBundleError as error:
        raise InputError(f"{before.fetched.where}: {error}: a robot has a destination of its own") from None


def _deliver_to_all(destinations: Sequence[Destination], deliveries: Sequence[Delivery]) -> None:
    """Stage all deliveries, then complete them; what was not completed is withdrawn."""
    completed: list[str] = []
    try:
        for destination, delivery in zip(destinations, deliveries, strict=True):
            destination.stage(delivery)
        for destination in destinations:
            destination.complete()
            completed.append(destination.name)
    except BaseException as error:
        for destination in destinations[len(completed) :]:
            with suppress(CalibrationError):  # the first error is told
                destination.withdraw()
        if completed and isinstance(error, CalibrationError):
            raise type(error)(f"{error}; delivered already to {', '.join(completed)}: run it again") from None
        raise
