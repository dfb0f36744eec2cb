"""Poses, joints and headers of messages, as ATOM's datasets write them."""

from typing import Any

import numpy as np

from calibration.dataset.model import Edge
from calibration.geometry import rotations
from calibration.geometry.joints import JOINT_PARAMETERS
from calibration.geometry.types import Array
from calibration.simulation.joints import joint_values
from calibration.simulation.robot import Joint

POSE_DECIMALS = 9
"""Of exact poses: a nanometre and a nanoradian, so that the last bits of a machine's arithmetic do not show."""


def pose_document(edge: Edge, T: Array, decimals: int = POSE_DECIMALS) -> dict[str, Any]:
    """A transform (4, 4); of the two quaternions of a rotation the one whose last component is positive."""
    quaternion = np.round(rotations.to_quaternion(T[:3, :3]), decimals)
    last = quaternion[np.flatnonzero(quaternion)[-1]]
    return {
        "parent": edge[0],
        "child": edge[1],
        "trans": (np.round(T[:3, 3], decimals) + 0.0).tolist(),
        "quat": (quaternion * np.sign(last) + 0.0).tolist(),
    }


def joint_document(joint: Joint, position: float) -> dict[str, Any]:
    """The entry of a collection's ``joints``: the description's parameters, and the encoder's position in rad or m."""
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


def message_header(frame: str, number: int) -> dict[str, Any]:
    """The header of a ROS message: ten seconds from pose to pose."""
    return {"frame_id": frame, "seq": number, "stamp": {"secs": 10 * number, "nsecs": 0}}
