"""Judges each image of a recording as it arrives: whether its view is used, why not, and what is covered."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.dataset.pattern import Pattern
from calibration.robot.importing.arrivals import Arrival
from calibration.robot.importing.image_views import View, read_image, view_of_image
from calibration.robot.importing.look.images import LookedFor, measured
from calibration.robot.importing.look.looking import MAX_BLUR_PX, MAX_SATURATED, MIN_WHITE
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import grey
from calibration.robot.simulation.record import COVERAGE_COLUMNS, COVERAGE_ROWS, image_cells

MAX_TILT = 65.0
"""degrees: limit of a pattern's tilt; beyond it corners are too narrow to be accurate (docs/recording.md)."""
SAME_POSE_SHARE = 0.01
"""Of the image's width: a view of whose corners none has moved farther from those of another one is the same."""


@dataclass(frozen=True, eq=False)
class JudgedImage:
    """Image that has arrived."""

    arrival: Arrival
    view: View | None = None
    """None if it cannot be read."""
    kind: str = ""
    """Kind of the reason why it is not used; empty if it is."""
    reason: str = ""
    """That reason, with its numbers."""
    remarks: tuple[str, ...] = ()
    """What is measured on it, of a used one."""


@dataclass(eq=False)
class SeenByCamera:
    """What a camera has seen so far."""

    size: tuple[int, int] | None = None
    """Width and height of its images, px."""
    names: list[str] = field(default_factory=list)
    """Of the files of used views."""
    corners: list[Array] = field(default_factory=list)
    """(K, 2): of each used view, all corners of all patterns, NaN where one is not seen."""
    cells: set[int] = field(default_factory=set)
    """Of the image, with corners."""

    @property
    def coverage(self) -> str:
        """Rows of the image, with an x where corners are."""
        cells = ["x" if cell in self.cells else "." for cell in range(COVERAGE_COLUMNS * COVERAGE_ROWS)]
        return " ".join("".join(cells[k : k + COVERAGE_COLUMNS]) for k in range(0, len(cells), COVERAGE_COLUMNS))


class ImageJudge:
    """Judge of the images of some cameras."""

    def __init__(self, patterns: Mapping[str, PatternConfiguration], cameras: tuple[str, ...] = ()) -> None:
        """Create the detectors; cameras that are not named are added when their first image arrives.

        Raises:
            InputError: a pattern cannot be detected.
        """
        self.cameras = {name: SeenByCamera() for name in cameras}
        self._kinds: dict[Path, str] = {}
        self._patterns = {name: each.pattern() for name, each in patterns.items()}
        self._detectors = {name: corner_detector(each) for name, each in patterns.items()}

    def judge(self, arrival: Arrival) -> JudgedImage:
        """Judge an image, and remember its view if it is used."""
        try:
            judged = self._judge(arrival)
        except InputError as error:
            judged = JudgedImage(arrival, None, "unreadable", str(error).removeprefix(f"{arrival.path}: "))
        self._kinds[arrival.path] = judged.kind
        return judged

    @property
    def counts(self) -> Counter[str]:
        """Number of images by the kind of the reason why they are not used; of used ones it is empty."""
        return Counter(self._kinds.values())

    def _judge(self, arrival: Arrival) -> JudgedImage:
        image, seen = grey(read_image(arrival.path)), self.cameras.setdefault(arrival.sensor, SeenByCamera())
        view = view_of_image(image, str(arrival.path), self._detectors)

        def refused(kind: str, reason: str) -> JudgedImage:
            return JudgedImage(arrival, view, kind, reason)

        if seen.size is not None and seen.size != (view.width, view.height):
            width, height = seen.size
            return refused("other size", f"{view.width} x {view.height} pixels, expected {width} x {height} as before")
        found = {name: labels for name, each in view.found.items() if (labels := each.labels) is not None}
        if not found:
            blur = measured(image, None).blur_px or 0.0
            why = f"; the image is blurred by {blur:.1f} px" if blur > MAX_BLUR_PX else ""
            return refused("no pattern", f"no pattern: {view.reason}{why}")
        together = self._joined(found)
        about = measured(image, LookedFor("", lambda _: together))
        if about.blur_px is not None and about.blur_px > MAX_BLUR_PX:
            return refused("blurred", f"blurred by {about.blur_px:.1f} px, {MAX_BLUR_PX:g} at most: hold still, focus")
        tilt = min(tilt_of(self._patterns[name], labels) for name, labels in found.items())
        if tilt > MAX_TILT:
            return refused("too oblique", f"too oblique: tilted by {tilt:.0f} degrees, {MAX_TILT:.0f} at most")
        corners = np.full((sum(len(each.corners) for each in self._patterns.values()), 2), np.nan)
        corners[together.ids] = together.pixels
        if (same := _same_view(seen, corners, SAME_POSE_SHARE * view.width)) is not None:
            return refused("same as before", f"same as {same}: move the board or the robot")
        seen.size = view.width, view.height
        seen.names.append(arrival.path.name)
        seen.corners.append(corners)
        seen.cells.update(image_cells(view.width, view.height, [together]))
        whole = sum(len(self._patterns[name].corners) for name in found)
        count = len(together.ids)
        remarks = [f"{count} corners" if count == whole else f"{count} of {whole} corners (board cut)"]
        remarks.append(f"tilt {tilt:.0f} deg")
        if about.blur_px is not None:
            remarks.append(f"blur {about.blur_px:.1f} px")
        remarks += ["dark: more light"] if about.white < MIN_WHITE else []
        remarks += ["overexposed: expose less"] if about.saturated > MAX_SATURATED else []
        return JudgedImage(arrival, view, remarks=tuple(remarks))

    def _joined(self, found: Mapping[str, CornerLabels]) -> CornerLabels:
        """Return the corners of all patterns, with ids that count through them."""
        counts = [len(pattern.corners) for pattern in self._patterns.values()]
        firsts = dict(zip(self._patterns, np.cumsum([0, *counts]).tolist(), strict=False))
        ids = np.concatenate([labels.ids + firsts[name] for name, labels in found.items()])
        return CornerLabels(ids, np.concatenate([labels.pixels for labels in found.values()]))


def tilt_of(pattern: Pattern, labels: CornerLabels) -> float:
    """Return the angle in degrees between a pattern and the image plane, by its foreshortening: no lens is needed.

    90 of corners in one line.
    """
    board = pattern.corners[labels.ids, :2]
    board, pixels = board - board.mean(0), labels.pixels - labels.pixels.mean(0)
    if np.linalg.matrix_rank(board, tol=1e-6) < 2:
        return 90.0
    sizes = np.linalg.svd(np.linalg.lstsq(board, pixels, rcond=None)[0], compute_uv=False)
    return float(np.degrees(np.arccos(np.clip(sizes[1] / sizes[0], 0, 1))))


def _same_view(seen: SeenByCamera, corners: Array, within: float) -> str | None:
    """Return the name of a used view whose corners are where these (K, 2) are, within some px; None without any."""
    if not seen.corners:
        return None
    moved = np.fmax.reduce(np.hypot(*np.moveaxis(np.stack(seen.corners) - corners, -1, 0)), axis=1)
    found = np.flatnonzero(moved <= within)
    return seen.names[found[0]] if len(found) else None
