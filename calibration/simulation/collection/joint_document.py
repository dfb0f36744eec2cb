"""Joints as ATOM's datasets write them: the parameters of the description, and the position that the encoder told."""

from typing import Any

from calibration.geometry.joints import JOINT_PARAMETERS
from calibration.simulation.collection.pose_document import POSE_DECIMALS
from calibration.simulation.joints import joint_values
from calibration.simulation.robot import Joint


def joint_document(joint: Joint, position: float) -> dict[str, Any]:
    """The entry of a collection's ``joints``, at a position in rad or m."""
    values = dict(zip(JOINT_PARAMETERS[:6], joint_values(joint).tolist(), strict=False))
    return {
        "transform_key": f"{joint.parent}-{joint.child}",
        "position": position,
        **{parameter: round(value, POSE_DECIMALS) + 0.0 for parameter, value in values.items()},
        **{f"axis_{axis}": value for axis, value in zip("xyz", joint.axis.tolist(), strict=True)},
        "parent_link": joint.parent,
        "child_link": joint.child,
        "joint_type": joint.kind,
    }
