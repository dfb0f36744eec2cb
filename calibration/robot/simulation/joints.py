"""Joints of a robot in ATOM's parameters, nominal (of the description) and true."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.base.records import between
from calibration.engine.geometry import rotations
from calibration.engine.geometry.joints import JOINT_PARAMETERS, JointModel, JointParameter
from calibration.robot.simulation.robot import Joint, Robot

MAX_ERROR = 1.0
"""m and rad: limit of a parameter's error."""
JointErrors = Mapping[str, Mapping[JointParameter, Annotated[float, between(-MAX_ERROR, MAX_ERROR)]]]
"""Errors of joint parameters by the joint's name, to be added to the description's values, m and rad."""


def joint_model(joint: Joint) -> JointModel:
    """Return the kinematic model of a joint."""
    x, y, z = joint.axis.tolist()
    return JointModel(joint.kind == "prismatic", (x, y, z))


def joint_values(joint: Joint, errors: Mapping[JointParameter, float] | None = None) -> Array:
    """Return all parameters (7,) of a joint in the order of `JOINT_PARAMETERS`: the description's plus the errors."""
    origin, rpy = joint.T_parent_joint[:3, 3], rotations.to_rpy(joint.T_parent_joint[:3, :3])
    values = np.concatenate([origin, rpy, [0.0]])
    for parameter, error in (errors or {}).items():
        values[JOINT_PARAMETERS.index(parameter)] += error
    return values


def with_errors(robot: Robot, errors: JointErrors) -> Robot:
    """Return the robot with erroneous joints; the same object if there are no errors.

    The bias of a joint's position is added to its origin: both precede the motion by the position.
    """

    def moved(joint: Joint) -> Joint:
        own = errors.get(joint.name)
        return replace(joint, T_parent_joint=joint_model(joint).pose(joint_values(joint, own))) if own else joint

    return replace(robot, joints=tuple(moved(joint) for joint in robot.joints)) if any(errors.values()) else robot


def check_calibrated_joints(joints: Mapping[str, tuple[str, ...]], robot: Robot, where: str) -> None:
    """Check that the calibrated joints and parameters of a configuration exist in the robot.

    Raises:
        InputError: begins with ``where``; a joint is not movable, or a parameter is unknown or missing.
    """
    for name, parameters in joints.items():
        if name not in robot.movable:
            known = ", ".join(robot.movable) or "none"
            raise InputError(f"{where}/{name}: {robot.path} has no joint '{name}' that moves (there are: {known})")
        unknown = [parameter for parameter in parameters if parameter not in JOINT_PARAMETERS]
        if unknown or not parameters:
            found = f"found '{unknown[0]}'" if unknown else "found no parameter"
            raise InputError(
                f"{where}/{name}/params_to_calibrate: {found}, expected one or more of {', '.join(JOINT_PARAMETERS)}"
            )
