"""Calibrated transforms against the true ones, where those are known."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from calibration.dataset.model import Dataset, Joint, Sensor
from calibration.dataset.truth import Truth
from calibration.errors import InputError
from calibration.geometry.joints import JOINT_PARAMETERS, JointParameter
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
class JointError:
    """How far one parameter of a joint is from the true one."""

    joint: str
    parameter: JointParameter
    error: float
    """The size of the difference, rad or m."""
    unit: Literal["m", "rad"]


@dataclass(frozen=True)
class TruthError:
    """The errors of a calibration: of each calibrated sensor, or of each pair where only pairs are determined."""

    poses: tuple[PoseError, ...]
    joints: tuple[JointError, ...] = ()
    """Of each calibrated parameter of a joint."""

    @property
    def translation_mm(self) -> float:
        """The largest of all."""
        return max(pose.translation_mm for pose in self.poses)

    @property
    def rotation_deg(self) -> float:
        """The largest of all, not necessarily of the same pose."""
        return max(pose.rotation_deg for pose in self.poses)

    @property
    def joint_mm(self) -> float | None:
        """The largest of the joints' parameters that are lengths; None where none is."""
        return max((1000 * each.error for each in self.joints if each.unit == "m"), default=None)

    @property
    def joint_deg(self) -> float | None:
        """The largest of the joints' parameters that are angles; None where none is."""
        return max((float(np.degrees(each.error)) for each in self.joints if each.unit == "rad"), default=None)


def truth_error(dataset: Dataset, truth: Truth) -> TruthError:
    """The errors of the calibrated transforms, without what no calibration can know.

    Two or more sensors of which none is anchored may all have moved together: the pose between the
    data frames of every two of them is compared, seen from either, the worse of the two. Otherwise it is
    the calibrated transform of each sensor but the anchored one, unless that is the only one and joints are
    calibrated. Of collections that have labels, the worst counts, should a chain differ between them.

    Raises:
        InputError: the truth lacks a sensor or a joint, something is missing or not finite, or nothing is calibrated.
    """
    sensors = list(dataset.sensors.values())
    missing = [s for s in sensors if s.edge not in truth.transforms]
    if missing:
        raise InputError(f"{truth.path}: sensor '{missing[0].name}': no true transform '{'-'.join(missing[0].edge)}'")
    labelled = [i for i, c in enumerate(dataset.collections) if c.labels]
    if not labelled:
        raise InputError(f"{dataset.path}: no collection has labels: nothing is calibrated")
    found = dataset.with_collections(labelled)
    joints = {name: _true_values(joint, truth) for name, joint in found.joints.items()}
    true = found.with_transforms({s.edge: truth.transforms[s.edge] for s in sensors}).with_joints(joints)
    return error_against(found, true, relative=dataset.anchored is None)


def error_against(found: Dataset, true: Dataset, relative: bool) -> TruthError:
    """The errors of a dataset's sensors and joints against those of another one with the same collections.

    Args:
        found: what is judged.
        true: what it is held against.
        relative: whether the pose between the data frames of every two sensors is compared, where there are two.

    Raises:
        InputError: something is missing or not finite, or nothing is calibrated.
    """
    sensors = list(found.sensors.values())
    of_joints = tuple(
        error for name in true.joints for error in _of_joint(found.joints[name], true.joints[name].values)
    )
    if relative and len(sensors) > 1:
        return TruthError(tuple(_between(a, b, found, true) for a, b in combinations(sensors, 2)), of_joints)
    calibrated = [s for s in sensors if s.name != found.anchored] or (sensors if of_joints else [])
    if not calibrated:
        raise InputError(f"{found.path}: only sensor '{found.anchored}', and it is anchored: nothing is calibrated")
    poses = tuple(_worst(s.name, true.transform(*s.edge), found.transform(*s.edge)) for s in calibrated)
    return TruthError(poses, of_joints)


def _true_values(joint: Joint, truth: Truth) -> Array:
    """All parameters (7,) of a joint, the calibrated ones as they are in truth."""
    values, true = joint.values.copy(), truth.joints.get(joint.name, {})
    for parameter in joint.parameters:
        if parameter not in true:
            raise InputError(f"{truth.path}: joint '{joint.name}': no true '{parameter}'")
        values[JOINT_PARAMETERS.index(parameter)] = true[parameter]
    return values


def _of_joint(joint: Joint, true: Array) -> Iterator[JointError]:
    """The errors of the calibrated parameters, all true ones (7,) being given."""
    for parameter in joint.parameters:
        at, unit = JOINT_PARAMETERS.index(parameter), joint.model.unit(parameter)
        difference = float(joint.values[at] - true[at])
        error = abs(difference if unit == "m" else math.remainder(difference, math.tau))
        if not math.isfinite(error):
            raise InputError(f"'{parameter}' of joint '{joint.name}' is not finite: its error cannot be told")
        yield JointError(joint.name, parameter, error, unit)


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
