"""An evaluation by a short text, such as ``rgb-to-rgb:right_camera:left_camera``."""

from dataclasses import dataclass
from typing import Literal, get_args

from calibration.dataset.model import Dataset
from calibration.dataset.truth import Truth
from calibration.errors import InputError
from calibration.evaluation.annotation import annotation_for
from calibration.evaluation.lidar_to_rgb import lidar_to_rgb
from calibration.evaluation.rgb_to_rgb import inter_collection_rgb_to_rgb, rgb_to_rgb
from calibration.evaluation.selection import pattern_of
from calibration.evaluation.table import Table

Kind = Literal["rgb-to-rgb", "inter-collection-rgb-to-rgb", "lidar-to-rgb"]

_FORMS = tuple(f"{kind}:{'LIDAR:CAMERA' if kind == 'lidar-to-rgb' else 'SOURCE:TARGET'}" for kind in get_args(Kind))


@dataclass(frozen=True)
class Evaluation:
    """Which table to make of a dataset."""

    kind: Kind
    source: str
    """The camera whose labels are carried over, or the LiDAR."""
    target: str
    """The camera whose labels, or whose images' annotation, they are compared with."""
    pattern: str | None = None
    """None where there is only one."""

    def __str__(self) -> str:
        """The text that `parse_evaluation` reads."""
        return ":".join((self.kind, self.source, self.target, *([] if self.pattern is None else [self.pattern])))

    def run(self, dataset: Dataset, truth: Truth | None = None) -> Table:
        """The table of a dataset as its transforms stand.

        Args:
            dataset: with the transforms to evaluate.
            truth: where the LiDAR's annotation may come from; see `annotation_for`.

        Raises:
            InputError: the dataset lacks a sensor or pattern, or nothing of it can be compared.
        """
        if self.kind == "rgb-to-rgb":
            return rgb_to_rgb(dataset, self.source, self.target, self.pattern)
        if self.kind == "inter-collection-rgb-to-rgb":
            return inter_collection_rgb_to_rgb(dataset, self.source, self.target, self.pattern)
        annotation = annotation_for(dataset, self.target, pattern_of(dataset, self.pattern), truth)
        return lidar_to_rgb(dataset, self.source, self.target, annotation, self.pattern)


def parse_evaluation(text: str) -> Evaluation:
    """Read ``KIND:SOURCE:TARGET`` or ``KIND:SOURCE:TARGET:PATTERN``.

    Raises:
        InputError: the text has another form.
    """
    kind, *names = (part.strip() for part in text.split(":"))
    known = next((k for k in get_args(Kind) if k == kind), None)
    if known is None or len(names) not in (2, 3) or not all(names):
        raise InputError(
            f"evaluation '{text}': expected {' or '.join(_FORMS)}, with ':PATTERN' where there are several"
        )
    return Evaluation(known, *names)
