"""Poses of a robot at work, by positions of its joints that the recording need not have."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset, Edge


@dataclass(frozen=True, eq=False)
class WorkPoses:
    """V poses of a robot, as its description tells them."""

    count: int
    """V."""
    transforms: Mapping[Edge, Array]
    """(V, 4, 4): by the transforms of the dataset that the given joints move."""
    positions: Mapping[Edge, Array]
    """(V,): of those that are a single joint, rad or m."""
    others: Mapping[Edge, tuple[str, ...]]
    """By transforms that joints move whose position is not given, their names."""

    def taken_by(self, dataset: Dataset) -> Dataset:
        """Return a dataset of V collections with these poses; calibrated joints keep the parameters that it has."""
        joints = {
            name: replace(joint, positions=self.positions[joint.edge])
            for name, joint in dataset.joints.items()
            if joint.edge in self.positions
        }
        calibrated = {joint.edge: np.asarray(joint.transform) for joint in joints.values()}
        return replace(dataset, joints={**dataset.joints, **joints}).with_transforms({**self.transforms, **calibrated})
