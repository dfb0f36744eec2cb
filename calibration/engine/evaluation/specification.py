"""Evaluations specified by a short text, such as ``rgb-to-rgb:right_camera:left_camera``."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from calibration.base import InputError
from calibration.engine.dataset.model import Dataset
from calibration.engine.evaluation.label_errors import MEASURED_POSE_COLUMNS, measured_poses, single_rgb
from calibration.engine.evaluation.table import RMS_PIX, Table
from calibration.engine.evaluation.truth import Truth, ground_truth_frame, ground_truth_transform
from calibration.engine.evaluation.two_sensors import (
    annotation_for,
    depth_to_depth,
    depth_to_rgb,
    inter_collection_rgb_to_rgb,
    lidar_to_depth,
    lidar_to_lidar,
    lidar_to_rgb,
    rgb_to_rgb,
)
from calibration.engine.evaluation.views import pattern_of

Names = tuple[str, ...]
Run = Callable[[Dataset, Truth | None, Names], Table]
"""Function of the dataset, the truth if there is one, and the names."""


@dataclass(frozen=True)
class Suggestion:
    """Datasets for which a kind of table is the first choice, of two sensors or of one."""

    families: Names
    """Families of the two sensors, which see a pattern together; or of the only sensor."""
    reason: str
    """What the table compares, with ``{0}`` and ``{1}`` for the names of the sensors."""
    by_arm: bool = False
    """Whether it needs a pattern that is fixed, and one sensor of the family."""


@dataclass(frozen=True)
class TableKind:
    """Kind of table: the names in its text, and the function that computes it."""

    needs: Names
    """Names required in the text."""
    may: Names
    """Optional names after them."""
    run: Run
    rms: str | None = RMS_PIX
    """Column whose average is the RMS of a calibration, px; None if the table has none."""
    poses: tuple[str, str] | None = None
    """Columns whose averages are the distance of measured poses, mm and degrees; None if the table has none."""
    suggestion: Suggestion | None = None
    """For which datasets `calibration init` takes it; None for none."""

    def sensors(self, names: Names) -> Names:
        """Return the names that must be sensors."""
        return tuple(
            name for name, what in zip(names, self.needs + self.may, strict=False) if what in _SENSOR_PLACEHOLDERS
        )


_SENSOR_PLACEHOLDERS = ("SOURCE", "TARGET", "CAMERA", "LIDAR", "DEPTH", "SENSOR")


def _of_pair(table: Callable[..., Table], dataset: Dataset, _: Truth | None, names: Names, **how: bool) -> Table:
    return table(dataset, names[0], names[1], _nth_name(names, 2), **how)


def _to_image(table: Callable[..., Table], dataset: Dataset, truth: Truth | None, names: Names, **how: bool) -> Table:
    pattern = _nth_name(names, 2)
    annotation = annotation_for(dataset, names[1], pattern_of(dataset, pattern), truth)
    return table(dataset, names[0], names[1], annotation, pattern, **how)


def _nth_name(names: Names, n: int) -> str | None:
    return names[n] if len(names) > n else None


def _with_inter_collection(
    name: str, needs: Names, run: "partial[Table]", rms: str | None = RMS_PIX, suggestion: Suggestion | None = None
) -> dict[str, TableKind]:
    """Return the kind of table of two sensors in each collection, and that between collections."""
    return {
        name: TableKind(needs, _PATTERN_PLACEHOLDER, run, rms, suggestion=suggestion),
        f"inter-collection-{name}": TableKind(needs, _PATTERN_PLACEHOLDER, partial(run, between=True), rms),
    }


_PATTERN_PLACEHOLDER = ("PATTERN",)
TABLE_KINDS: Mapping[str, TableKind] = {
    "rgb-to-rgb": TableKind(
        ("SOURCE", "TARGET"),
        _PATTERN_PLACEHOLDER,
        partial(_of_pair, rgb_to_rgb),
        suggestion=Suggestion(("camera", "camera"), "the corners that {0} sees, in the images of {1}"),
    ),
    "inter-collection-rgb-to-rgb": TableKind(
        ("SOURCE", "TARGET"),
        _PATTERN_PLACEHOLDER,
        partial(_of_pair, inter_collection_rgb_to_rgb),
        suggestion=Suggestion(("camera",), "each view of the pattern carried to all others by the arm", by_arm=True),
    ),
    "single-rgb": TableKind(
        (),
        ("CAMERA", "PATTERN"),
        lambda dataset, _, names: single_rgb(dataset, _nth_name(names, 0), _nth_name(names, 1)),
        rms=None,
    ),
    "measured-poses": TableKind(
        ("SENSOR",),
        _PATTERN_PLACEHOLDER,
        lambda dataset, _, names: measured_poses(dataset, names[0], _nth_name(names, 1)),
        rms=None,
        poses=MEASURED_POSE_COLUMNS,
        suggestion=Suggestion(("tracker",), "the poses as they were measured, against those of the result"),
    ),
    **_with_inter_collection(
        "lidar-to-rgb",
        ("LIDAR", "CAMERA"),
        partial(_to_image, lidar_to_rgb),
        suggestion=Suggestion(("lidar", "camera"), "the points of {0} against the images of {1}"),
    ),
    **_with_inter_collection(
        "depth-to-rgb",
        ("DEPTH", "CAMERA"),
        partial(_to_image, depth_to_rgb),
        suggestion=Suggestion(("depth camera", "camera"), "the points of {0} against the images of {1}"),
    ),
    **_with_inter_collection("lidar-to-lidar", ("SOURCE", "TARGET"), partial(_of_pair, lidar_to_lidar), rms=None),
    **_with_inter_collection("lidar-to-depth", ("LIDAR", "DEPTH"), partial(_of_pair, lidar_to_depth)),
    **_with_inter_collection("depth-to-depth", ("SOURCE", "TARGET"), partial(_of_pair, depth_to_depth)),
    "ground-truth-transform": TableKind(
        ("PARENT", "CHILD"), (), lambda dataset, truth, names: ground_truth_transform(dataset, truth, *names), rms=None
    ),
    "ground-truth-frame": TableKind(
        ("FRAME",), ("SENSOR",), lambda dataset, truth, names: ground_truth_frame(dataset, truth, *names), rms=None
    ),
}
"""Kinds of tables: ATOM's, by the name of its script, and the one of measured poses, which ATOM lacks."""


def _file_name(kind: str) -> str:
    return f"{kind.replace('-', '_')}_results.csv"


FILES_WITHOUT_RMS = frozenset(_file_name(name) for name, kind in TABLE_KINDS.items() if kind.rms is None)
"""Names of the files of tables that have no RMS in px."""


@dataclass(frozen=True)
class Evaluation:
    """Table to compute: its kind, and the names of sensors, frames and patterns."""

    kind: str
    """Kind of the table, a key of `TABLE_KINDS`."""
    names: Names
    """Names of sensors, frames and patterns, as its kind requires."""

    def __str__(self) -> str:
        """Return the text that `parse_evaluation` reads."""
        return ":".join((self.kind, *self.names))

    @property
    def sensors(self) -> Names:
        """Names that must be sensors of the dataset."""
        return TABLE_KINDS[self.kind].sensors(self.names)

    @property
    def table(self) -> TableKind:
        """Kind of the table."""
        return TABLE_KINDS[self.kind]

    @property
    def file_name(self) -> str:
        """Name of the table's file."""
        return _file_name(self.kind)

    def run(self, dataset: Dataset, truth: Truth | None = None) -> Table:
        """Return the table of a dataset with its current transforms.

        Args:
            dataset: the transforms to evaluate.
            truth: the reference of the tables ``ground-truth-*``, and possibly the source of image annotations;
                see `annotation_for`.

        Raises:
            InputError: the dataset lacks a sensor, a frame or a pattern, or contains nothing to compare.
        """
        return TABLE_KINDS[self.kind].run(dataset, truth, self.names)


def parse_evaluation(text: str) -> Evaluation:
    """Parse a kind and its names, ``KIND:SOURCE:TARGET`` or ``KIND:SOURCE:TARGET:PATTERN``.

    Raises:
        InputError: there is no such kind, or it requires other names.
    """
    name, *names = (part.strip() for part in text.split(":"))
    if name not in TABLE_KINDS:
        raise InputError(f"evaluation '{text}': there is no table '{name}' (tables: {', '.join(TABLE_KINDS)})")
    kind = TABLE_KINDS[name]
    if not len(kind.needs) <= len(names) <= len(kind.needs) + len(kind.may) or not all(names):
        form = ":".join((name, *kind.needs)) + "".join(f"[:{each}]" for each in kind.may)
        raise InputError(f"evaluation '{text}': expected {form}")
    return Evaluation(name, tuple(names))
