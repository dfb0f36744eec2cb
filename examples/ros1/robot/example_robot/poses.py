"""Poses as 4x4 matrices ``T_parent_child``, and as the dataset has them."""

import numpy as np
from scipy.spatial.transform import Rotation


def pose(rotation, translation):
    """From a rotation and a translation."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), np.ravel(translation)
    return T


def from_vector(vector):
    """From a translation and a rotation vector, six numbers."""
    return pose(Rotation.from_rotvec(vector[3:]), vector[:3])


def to_vector(T):
    """The inverse of `from_vector`."""
    return np.concatenate([T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_rotvec()])


def from_entry(entry):
    """From ``trans`` and ``quat`` [x, y, z, w] of a dataset."""
    return pose(Rotation.from_quat(entry["quat"]), entry["trans"])


def to_entry(parent, child, T):
    """As a dataset has it."""
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat()
    return {"parent": parent, "child": child, "trans": T[:3, 3].tolist(), "quat": quaternion.tolist()}


def chain(edges, start, end):
    """The edges (parent, child) that lead from one frame down to another, or None."""
    parents = {child: parent for parent, child in edges}
    found = []
    while end != start:
        if end not in parents or len(found) > len(parents):
            return None
        found.insert(0, (parents[end], end))
        end = parents[end]
    return found


def along(transforms, start, end):
    """``T_start_end`` from the transforms of one collection."""
    edges = {(entry["parent"], entry["child"]): entry for entry in transforms.values()}
    steps = chain(edges, start, end)
    if steps is None:
        raise ValueError(f"no transform leads from {start} to {end}")
    T = np.eye(4)
    for step in steps:
        T = T @ from_entry(edges[step])
    return T
