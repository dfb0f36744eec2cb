"""What ``look`` reports."""

from collections.abc import Mapping
from pathlib import Path

from calibration.base.records import field, result
from calibration.base.verdict import verdict_of
from calibration.ci.report import Outcome, Report, Table, count_of
from calibration.ci.report.blocks import shown
from calibration.robot.simulation.collection.record import COVERAGE_COLUMNS, COVERAGE_ROWS

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


def report(results: LookResults, folder: Path | None) -> Report:
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
