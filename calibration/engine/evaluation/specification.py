"""Evaluations specified by a short text, such as ``rgb-to-rgb:right_camera:left_camera``."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from calibration.base.errors import InputError
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.truth import Truth
from calibration.engine.evaluation.annotation import Annotation, annotation_for
from calibration.engine.evaluation.ground_truth import ground_truth_frame, ground_truth_transform
from calibration.engine.evaluation.measured_poses import MEASURED_POSE_COLUMNS, measured_poses
from calibration.engine.evaluation.range_to_range import depth_to_depth, lidar_to_depth, lidar_to_lidar
from calibration.engine.evaluation.range_to_rgb import (
    depth_to_rgb,
    inter_collection_depth_to_rgb,
    inter_collection_lidar_to_rgb,
    lidar_to_rgb,
)
from calibration.engine.evaluation.rgb_to_rgb import inter_collection_rgb_to_rgb, rgb_to_rgb
from calibration.engine.evaluation.selection import pattern_of
from calibration.engine.evaluation.single_rgb import single_rgb
from calibration.engine.evaluation.table import RMS_PIX, Table

Names = tuple[str, ...]


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
    run: Callable[[Dataset, Truth | None, Names], Table]
    """Function of the dataset, the truth if there is one, and the names."""
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
Pair = Callable[[Dataset, str, str, str | None], Table]
ToImage = Callable[[Dataset, str, str, Annotation, str | None], Table]


def _pair_table(table: Pair) -> Callable[[Dataset, Truth | None, Names], Table]:
    return lambda dataset, _, names: table(dataset, names[0], names[1], _nth_name(names, 2))


def _to_image(table: ToImage) -> Callable[[Dataset, Truth | None, Names], Table]:
    def run(dataset: Dataset, truth: Truth | None, names: Names) -> Table:
        pattern = _nth_name(names, 2)
        annotation = annotation_for(dataset, names[1], pattern_of(dataset, pattern), truth)
        return table(dataset, names[0], names[1], annotation, pattern)

    return run


def _nth_name(names: Names, n: int) -> str | None:
    return names[n] if len(names) > n else None


_PATTERN_PLACEHOLDER = ("PATTERN",)
TABLE_KINDS: Mapping[str, TableKind] = {
    "rgb-to-rgb": TableKind(
        ("SOURCE", "TARGET"),
        _PATTERN_PLACEHOLDER,
        _pair_table(rgb_to_rgb),
        suggestion=Suggestion(("camera", "camera"), "the corners that {0} sees, in the images of {1}"),
    ),
    "inter-collection-rgb-to-rgb": TableKind(
        ("SOURCE", "TARGET"),
        _PATTERN_PLACEHOLDER,
        _pair_table(inter_collection_rgb_to_rgb),
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
    "lidar-to-rgb": TableKind(
        ("LIDAR", "CAMERA"),
        _PATTERN_PLACEHOLDER,
        _to_image(lidar_to_rgb),
        suggestion=Suggestion(("lidar", "camera"), "the points of {0} against the images of {1}"),
    ),
    "inter-collection-lidar-to-rgb": TableKind(
        ("LIDAR", "CAMERA"), _PATTERN_PLACEHOLDER, _to_image(inter_collection_lidar_to_rgb)
    ),
    "depth-to-rgb": TableKind(
        ("DEPTH", "CAMERA"),
        _PATTERN_PLACEHOLDER,
        _to_image(depth_to_rgb),
        suggestion=Suggestion(("depth camera", "camera"), "the points of {0} against the images of {1}"),
    ),
    "inter-collection-depth-to-rgb": TableKind(
        ("DEPTH", "CAMERA"), _PATTERN_PLACEHOLDER, _to_image(inter_collection_depth_to_rgb)
    ),
    "lidar-to-lidar": TableKind(("SOURCE", "TARGET"), _PATTERN_PLACEHOLDER, _pair_table(lidar_to_lidar), rms=None),
    "inter-collection-lidar-to-lidar": TableKind(
        ("SOURCE", "TARGET"), _PATTERN_PLACEHOLDER, _pair_table(partial(lidar_to_lidar, between=True)), rms=None
    ),
    "lidar-to-depth": TableKind(("LIDAR", "DEPTH"), _PATTERN_PLACEHOLDER, _pair_table(lidar_to_depth)),
    "inter-collection-lidar-to-depth": TableKind(
        ("LIDAR", "DEPTH"), _PATTERN_PLACEHOLDER, _pair_table(partial(lidar_to_depth, between=True))
    ),
    "depth-to-depth": TableKind(("SOURCE", "TARGET"), _PATTERN_PLACEHOLDER, _pair_table(depth_to_depth)),
    "inter-collection-depth-to-depth": TableKind(
        ("SOURCE", "TARGET"), _PATTERN_PLACEHOLDER, _pair_table(partial(depth_to_depth, between=True))
    ),
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
