"""Calibrated transforms against the true ones, where those are known."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calibration.dataset.model import Dataset, Sensor
from calibration.dataset.truth import Truth
from calibration.errors import InputError
from calibration.geometry.transforms import distance, inverse
from calibration.geometry.types import Array


@dataclass(frozen=True)
class PoseError:
    """How far one pose lies from the true one."""

    name: str
    """A sensor, or two: ``left_camera/right_camera``."""
    translation_mm: float
    """The norm of the difference in position."""
    rotation_deg: float
    """The angle between the orientations."""


@dataclass(frozen=True)
class TruthError:
    """The errors of a calibration: of each calibrated sensor, or of each pair where only pairs are determined."""

    poses: tuple[PoseError, ...]

    @property
    def translation_mm(self) -> float:
        """The largest of all."""
        return max(pose.translation_mm for pose in self.poses)

    @property
    def rotation_deg(self) -> float:
        """The largest of all, not necessarily of the same pose."""
        return max(pose.rotation_deg for pose in self.poses)


def truth_error(dataset: Dataset, truth: Truth) -> TruthError:
    """The errors of the calibrated transforms, without what no calibration can know.

    Two or more sensors of which none is anchored may all have moved together: the pose between the
    data frames of every two of them is compared, seen from either, the worse of the two. Otherwise it is
    the calibrated transform of each sensor but the anchored one. Of collections that have labels,
    the worst counts, should a chain differ between them.

    Raises:
        InputError: the truth lacks a sensor, a transform is missing or not finite, or nothing is calibrated.
    """
    sensors = list(dataset.sensors.values())
    missing = [s for s in sensors if s.edge not in truth.transforms]
    if missing:
        raise InputError(f"{truth.path}: sensor '{missing[0].name}': no true transform '{'-'.join(missing[0].edge)}'")
    labelled = [i for i, c in enumerate(dataset.collections) if c.labels]
    if not labelled:
        raise InputError(f"{dataset.path}: no collection has labels: nothing is calibrated")
    found = dataset.with_collections(labelled)
    true = found.with_transforms({s.edge: truth.transforms[s.edge] for s in sensors})
    if dataset.anchored is None and len(sensors) > 1:
        return TruthError(tuple(_between(a, b, found, true) for a, b in combinations(sensors, 2)))
    calibrated = [s for s in sensors if s.name != dataset.anchored]
    if not calibrated:
        raise InputError(f"{dataset.path}: only sensor '{dataset.anchored}', and it is anchored: nothing is calibrated")
    return TruthError(tuple(_worst(s.name, true.transform(*s.edge), found.transform(*s.edge)) for s in calibrated))


def _between(a: Sensor, b: Sensor, found: Dataset, true: Dataset) -> PoseError:
    """The error of the pose between two data frames, worst seen from either."""
    T_true, T_found = (dataset.transform(a.frame, b.frame) for dataset in (true, found))
    both = np.concatenate([T_true, inverse(T_true)]), np.concatenate([T_found, inverse(T_found)])
    return _worst(f"{a.name}/{b.name}", *both)


def _worst(name: str, T_true: Array, T_found: Array) -> PoseError:
    if not (np.isfinite(T_true).all() and np.isfinite(T_found).all()):
        raise InputError(f"a transform of {name} is not finite: its error cannot be told")
    translation, angle = distance(T_true, T_found)
    return PoseError(name, float(1000 * translation.max()), float(np.degrees(angle.max())))
