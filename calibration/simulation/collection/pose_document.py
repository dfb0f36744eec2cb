"""Poses as ATOM's datasets write them."""

from typing import Any

import numpy as np

from calibration.dataset.model import Edge
from calibration.geometry import rotations
from calibration.geometry.types import Array

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
