"""What differs between two bundles of a robot: the next version that follows from it, and the changelog."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from calibration.addons.delivery.archive import RefusedBundleError
from calibration.addons.delivery.checking import Expectations, check_bundle
from calibration.addons.delivery.fetching import FetchedBundle
from calibration.addons.delivery.manifest import BundledSystem, Manifest
from calibration.base.documents import parse_json
from calibration.base.errors import InputError
from calibration.base.records import read
from calibration.ci.workflow.markdown import escape_markdown, markdown_table
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.comparison import BaselineComparison, compare
from calibration.engine.baseline.quality import SameData
from calibration.engine.baseline.verdict import exceeds, size_of_change
from calibration.pipeline.stages.exporting import CALIBRATION_FILE, ExportedCalibration

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
            try:
                document = parse_json(content, finite=True)
            except (ValueError, RecursionError) as error:
                raise InputError(f"{where}: {error}") from None
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
        elif _may_have_changed(comparison):
            yield Change(f"{now.name}: {change.name}", f"within its error bars: {size_of_change(change)}", "patch")


def _may_have_changed(comparison: BaselineComparison) -> bool:
    """Whether a difference is more than the rounding of another machine."""
    return not comparison.same_data or bool(comparison.other_inputs)


def _differs_beside_numbers(before: Manifest, now: Manifest) -> bool:
    """Whether a robot would see another bundle, apart from the last digits of numbers, the commit and the time."""
    return [(each.verdict, each.reasons, each.description, each.accepted_although) for each in before.systems] != [
        (each.verdict, each.reasons, each.description, each.accepted_although) for each in now.systems
    ]
