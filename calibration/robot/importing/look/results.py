"""Results of ``look``."""

from collections.abc import Mapping

from calibration.base.records import field, result


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
