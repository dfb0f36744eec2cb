"""Report of ``look``."""

from pathlib import Path

from calibration.base.verdict import verdict_of
from calibration.ci.report import Outcome, Report, Table, count_of
from calibration.ci.report.blocks import shown
from calibration.robot.importing.look.results import CameraSummary, FramesSummary, LookResults
from calibration.robot.simulation.collection.record import COVERAGE_COLUMNS, COVERAGE_ROWS

LOOK_TITLE = "look"
MAX_NAMES = 12
"""Frames and joints that are named in a table."""


def report(results: LookResults, folder: Path | None) -> Report:
    """Return the report of ``look``; the verdict is fail if a calibration lacks something."""
    needed = tuple(str(each) for each in results.missing if each.is_needed)
    topics = tuple(
        (name, each.type, str(each.messages), shown(each.rate_hz, ".1f"), shown(each.largest_gap_s, ".2f"))
        for name, each in results.topics.items()
    )
    return Report(
        title=LOOK_TITLE,
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
