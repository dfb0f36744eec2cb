"""What ``import-data``, ``label`` and ``look`` report: nothing is left out in silence."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

from calibration.base.records import field, result
from calibration.base.verdict import verdict_of
from calibration.ci.report import Outcome, Report, Table, count_of
from calibration.ci.report.blocks import shown
from calibration.robot.importing.bags.bag import NS_PER_S
from calibration.robot.simulation.record import COVERAGE_COLUMNS, COVERAGE_ROWS

IMPORT_TITLE, LABEL_TITLE = "import-data", "label"


@result
class RejectedView:
    """An image in which no pattern is detected."""

    file: str = field("The image.")
    reason: str = field("Why.")


@result
class SensorResult:
    """Results for the images of one camera, or the clouds or scans of one LiDAR."""

    images: int = field("Number of images.")
    labelled: int = field("Number of those with a pattern.")
    corners: int = field("Total number of corners, or points on a pattern.")
    intrinsics: Literal["given", "estimated", "none"] = field(
        "Where they come from; estimated ones are a start only; a LiDAR has none."
    )
    camera: Mapping[str, float] = field("The intrinsics by their names.")
    lens: str | None = field("Why an estimated camera has its lens model.", default=None)
    rejected: tuple[RejectedView, ...] = field("Images in which no pattern is detected.", default=())


@result
class LeftOut:
    """What an import left out by one rule in one place."""

    rule: str = field("Why.")
    place: str = field("The sensor, topic, frame or joint.")
    count: int = field("How many.")
    first_s: float | None = field("Stamp of the first.", default=None, unit="s")


@result
class ImportResults:
    """Results of import-data."""

    robot: str = field("Its name.")
    found: int = field("Number of moments found, of which the best are kept.")
    moments: int = field("Number of moments that were searched: images that belong together.")
    collections: int = field("Number of moments with a pattern: the collections of the dataset.")
    together: int = field("Collections in which two sensors or more see a pattern.")
    lag_ms: float = field("Largest time between the images of a moment.", unit="ms")
    sensors: Mapping[str, SensorResult] = field("By name.")
    evenly: str | None = field(
        "Reason why the moments are evenly spaced, and not those that calibrate best.", default=None
    )
    left_out: tuple[LeftOut, ...] = field("What was recorded and is not in the dataset.", default=())
    notes: tuple[str, ...] = field("What was read otherwise than recorded.", default=())


@result
class LabelledSensor:
    """Results for the labelled images of one camera."""

    images: int = field("Number of images that were searched.")
    labelled: int = field("Number of those with a pattern.")
    rejected: tuple[RejectedView, ...] = field("Images in which no pattern is detected.", default=())


@result
class LabelResults:
    """Results of label."""

    collections: int = field("Of the dataset.")
    sensors: Mapping[str, LabelledSensor] = field("By name.")


class LeftOutCounts:
    """What an import leaves out, counted by rule and place."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], LeftOut] = {}

    def add(self, rule: str, place: str, stamp: float | None = None, count: int = 1) -> None:
        """Count something.

        Args:
            rule: why it is left out.
            place: its sensor, topic, frame or joint.
            stamp: its time, ns.
            count: how many there are.
        """
        first_s = None if stamp is None else round(stamp / NS_PER_S, 6)
        before = self._found.get((rule, place), LeftOut(rule, place, 0, first_s))
        if count:
            self._found[rule, place] = replace(before, count=before.count + count)

    def of(self, place: str) -> Iterator[str]:
        """Yield in words what was left out of one place."""
        return (f"{each.count} left out: {each.rule}" for each in self._found.values() if each.place == place)

    def results(self) -> tuple[LeftOut, ...]:
        """Return them as results, in the order in which they were found."""
        return tuple(self._found.values())


def import_report(results: ImportResults, folder: Path) -> Report:
    """Return the report of ``import-data``."""
    found: Mapping[str, int] = {name: each.labelled for name, each in results.sensors.items()}
    estimated = {name: each.lens for name, each in results.sensors.items() if each.intrinsics == "estimated"}
    rejected = tuple((name, view.file, view.reason) for name, each in results.sensors.items() for view in each.rejected)
    return Report(
        title="Import",
        verdict="pass",
        sentence=f"{count_of(results.collections, 'collection')} of {count_of(results.found, 'moment')} in {folder}",
        results=results,
        outputs={"dataset": folder, "collections": results.collections, "labelled": found},
        notes=(
            *(
                f"'{name}' has intrinsics from its corners only: calibrate them too (intrinsics); {lens}"
                for name, lens in estimated.items()
            ),
            *(f"moments are evenly chosen: {why}" for why in [results.evenly] if why is not None),
            *results.notes,
        ),
        blocks=(
            Table(
                ("sensor", "images", "labelled", "corners", "intrinsics"),
                tuple(
                    (name, str(each.images), str(each.labelled), str(each.corners), each.intrinsics)
                    for name, each in results.sensors.items()
                ),
            ),
            Table(
                ("left out", "of", "count", "first (s)"),
                tuple(
                    (each.rule, each.place, str(each.count), "" if each.first_s is None else f"{each.first_s:.3f}")
                    for each in results.left_out
                ),
                title="Left out",
            ),
            Table(("sensor", "image", "why no pattern"), rejected, title="Images without a pattern", folded=True),
        ),
        suites={IMPORT_TITLE: [Outcome(name=name) for name in results.sensors]},
    )


def label_report(results: LabelResults, folder: Path) -> Report:
    """Return the report of ``label``."""
    rows = tuple((name, str(each.images), str(each.labelled)) for name, each in results.sensors.items())
    rejected = tuple((name, view.file, view.reason) for name, each in results.sensors.items() for view in each.rejected)
    return Report(
        title="Labels",
        verdict="pass",
        sentence=f"{sum(each.labelled for each in results.sensors.values())} images labelled in {folder}",
        results=results,
        outputs={"dataset": folder},
        blocks=(
            Table(("sensor", "images", "labelled"), rows),
            Table(("sensor", "image", "why no pattern"), rejected, title="Images without a pattern", folded=True),
        ),
        suites={LABEL_TITLE: [Outcome(name=name) for name in results.sensors]},
    )


LOOK_TITLE = "look"
MAX_NAMES = 12
"""Frames and joints that are named in a table."""


@result
class TopicSummary:
    """Messages of one topic of a bag."""

    type: str = field("Of its messages.")
    messages: int = field("How many there are.")
    rate_hz: float | None = field("How many a second; none of fewer than two.", unit="Hz")
    largest_gap_s: float | None = field("Longest time between two.", unit="s")


@result
class CameraSummary:
    """Images of one camera, measured on some that are evenly chosen."""

    place: str = field("Topic, folder, files or video.")
    images: int = field("How many there are.")
    looked_at: int = field("How many were decoded.")
    width: int = field("Of the first image.", unit="px")
    height: int = field("Of the first image.", unit="px")
    intrinsics: str = field("What camera_info says of a bag's camera; what import.yml names; none.")
    brightness: float = field("Median of the pixels, 0 to 255, over the images.")
    saturated: float = field("Share of white pixels, median over the images: on the pattern where it is found.")
    blur_px: float | None = field("Standard deviation of the blur of edges, median over the images.", unit="px")
    with_pattern: int = field("Number of the decoded images with a pattern.")
    cells: tuple[int, ...] = field("Cells of a grid of 4 x 3 over the image, row by row, with a corner of a pattern.")
    compared: int = field("Images with a pattern that follow another within half a second.")
    still: int = field("Those of them in which the pattern is where it was.")
    other_size: str = field("Another size of images of it; empty if all have one.", default="")
    fault: str = field("Why images or intrinsics cannot be read; empty if they can.", default="")


@result
class FramesSummary:
    """Frames and joints of a bag."""

    roots: tuple[str, ...] = field("Frames without a parent.")
    frames: int = field("How many there are.")
    moving: tuple[str, ...] = field("Frames that move in /tf.")
    joints: tuple[str, ...] = field("Joints that move.")
    robot_description: str = field("read, none, or why it cannot be read.")
    stays: int | None = field("How often all that carries a sensor or a pattern stands still; none if nothing moves.")


@result
class Missing:
    """What a calibration lacks."""

    what: str = field("What was found.")
    remedy: str = field("What to do.")
    page: str = field("Where the documentation says more.", default="docs/recording.md")
    is_needed: bool = field("Whether a calibration needs it; else it would be better with it.", default=True)

    def __str__(self) -> str:
        return f"{self.what}: {self.remedy} ({self.page})"


@result
class LookResults:
    """Results of look."""

    recording: str = field("The recording.")
    pattern: str | None = field("The pattern that was looked for; none if none was found or described.")
    topics: Mapping[str, TopicSummary] = field("Of a bag, by name.")
    frames: FramesSummary | None = field("Of a bag.")
    cameras: Mapping[str, CameraSummary] = field("By name.")
    missing: tuple[Missing, ...] = field("What a calibration lacks.")


def look_report(results: LookResults, folder: Path | None) -> Report:
    """Return the report of ``look``; the verdict is fail if a calibration lacks something."""
    needed = tuple(str(each) for each in results.missing if each.is_needed)
    topics = tuple(
        (name, each.type, str(each.messages), shown(each.rate_hz, ".1f"), shown(each.largest_gap_s, ".2f"))
        for name, each in results.topics.items()
    )
    return Report(
        title="Recording",
        verdict=verdict_of(not needed),
        sentence=f"{count_of(len(needed), 'thing')} missing for a calibration in {results.recording}"
        if needed
        else f"nothing is missing for a calibration in {results.recording}",
        results=results,
        outputs={"folder": folder},
        reasons=needed,
        notes=tuple(str(each) for each in results.missing if not each.is_needed),
        blocks=(
            Table(("topic", "type", "messages", "rate (Hz)", "largest gap (s)"), topics, title="Topics"),
            Table(("frames", ""), _frame_rows(results.frames), title="Frames"),
            Table(
                ("camera", "images", "size", "looked at", "brightness", "saturated", "blur (px)", "still"),
                tuple((name, *_image_cells(each)) for name, each in results.cameras.items()),
                title="Images",
            ),
            Table(
                ("camera", "intrinsics"),
                tuple((name, each.intrinsics) for name, each in results.cameras.items()),
                title="Intrinsics",
            ),
            Table(
                ("camera", "images with it", *(f"row {row + 1}" for row in range(COVERAGE_ROWS))),
                tuple((name, *_coverage_rows(each)) for name, each in results.cameras.items()),
                title=f"Pattern: {results.pattern or 'none found'}",
            ),
        ),
        suites={LOOK_TITLE: [Outcome(name=results.recording, reasons=needed)]},
    )


def _frame_rows(frames: FramesSummary | None) -> tuple[tuple[str, str], ...]:
    if frames is None:
        return ()
    return (
        ("number", str(frames.frames)),
        ("roots", _joined_names(frames.roots)),
        ("moving", _joined_names(frames.moving)),
        ("moving joints", _joined_names(frames.joints)),
        ("robot_description", frames.robot_description),
        ("stays of what carries sensors", "-" if frames.stays is None else str(frames.stays)),
    )


def _joined_names(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    return ", ".join(names[:MAX_NAMES]) + more or "none"


def _image_cells(camera: CameraSummary) -> tuple[str, ...]:
    return (
        str(camera.images),
        f"{camera.width} x {camera.height}",
        str(camera.looked_at),
        f"{camera.brightness:.0f}",
        f"{camera.saturated:.1%}",
        shown(camera.blur_px, ".1f"),
        f"{camera.still} of {camera.compared}" if camera.compared else "-",
    )


def _coverage_rows(camera: CameraSummary) -> tuple[str, ...]:
    """Return the number of images with the pattern, and each row of the image with an x where corners are."""
    rows = [
        "".join("x" if row * COVERAGE_COLUMNS + i in camera.cells else "." for i in range(COVERAGE_COLUMNS))
        for row in range(COVERAGE_ROWS)
    ]
    return (f"{camera.with_pattern} of {camera.looked_at}", *rows)
