"""Transforms, joints, intrinsics and residuals of all labels at the values of an optimum."""

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import BORDER_NOISE_KINDS
from calibration.engine.dataset.model import Dataset, Edge, PointLabels
from calibration.engine.estimation.covariance.result import CalibratedJoint, RejectedLabel, ViewResiduals
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.problem.blocks import CalibratedIntrinsics, Pose, Values
from calibration.engine.estimation.start.build import Setup
from calibration.engine.geometry.transforms import adjoint, inverse, translation


def transforms_of(setup: Setup, values: Values) -> dict[Edge, Array]:
    """Return the transforms of the shared blocks; those of patterns in their own frame, not at their centre."""
    patterns = {pattern.edge: pattern for pattern in setup.dataset.patterns.values()}
    return {
        edge: value @ inverse(translation(patterns[edge].centre)) if edge in patterns else value
        for block, value in zip(setup.problem.blocks, values, strict=True)
        if (edge := block.edge) and value.ndim == 2
    }


def calibrated_dataset(setup: Setup, values: Values, dataset: Dataset) -> Dataset:
    """Return the whole dataset with the new transforms, joints and intrinsics.

    Moving patterns have a pose where a view of them is used, else NaN; other moving transforms keep their guess there.
    """
    moving = {}
    kept = set(setup.dataset.keys)
    used = np.array([i for i, key in enumerate(dataset.keys) if key in kept])
    for i, block in enumerate(setup.problem.blocks):
        if not block.per_collection or block.held or not block.edge:
            continue
        seen = setup.problem.collections_with(i)
        if pattern := setup.dataset.patterns.get(block.name):
            poses = np.full((len(dataset.collections), 4, 4), np.nan)
            poses[used[seen]] = values[i][seen] @ inverse(translation(pattern.centre))
        else:
            poses = dataset.transforms[block.edge].copy()
            poses[used[seen]] = values[i][seen]
        moving[block.edge] = poses
    joints = {name: values[setup.block(joint.edge)] for name, joint in setup.dataset.joints.items()}
    cameras = {
        block.intrinsics.sensor: block.intrinsics.camera.with_intrinsics(value)
        for block, value in zip(setup.problem.blocks, values, strict=True)
        if block.intrinsics and not block.held
    }
    moved = dataset.with_transforms({**transforms_of(setup, values), **moving})
    moved = moved.with_joints(joints) if joints else moved
    return moved.with_cameras(cameras) if cameras else moved


def calibrated_joints(
    setup: Setup, values: Values, covariance: Mapping[int, Array], labels: Mapping[int, Array]
) -> dict[str, CalibratedJoint]:
    """Return the joints with free parameters; covariances by block, empty if it has not converged."""
    joints = {}
    for name, joint in setup.dataset.joints.items():
        i = setup.block(joint.edge)
        block = setup.problem.blocks[i]
        if block.joint and not block.held:
            free = block.joint.free
            joints[name] = CalibratedJoint(
                name=name,
                parameters=free,
                values=values[i][block.joint.at],
                units=tuple(joint.model.unit(parameter) for parameter in free),
                covariance=covariance.get(i, np.full((len(free), len(free)), np.nan)),
                label_covariance=labels.get(i, np.full((len(free), len(free)), np.nan)),
            )
    return joints


def calibrated_intrinsics(
    setup: Setup, values: Values, covariance: Mapping[int, Array]
) -> dict[str, CalibratedIntrinsics]:
    """Return the cameras with free intrinsics; covariances by block, empty if it has not converged."""
    found = {}
    for i, block in enumerate(setup.problem.blocks):
        if (intrinsics := block.intrinsics) and not block.held:
            k = len(intrinsics.free)
            found[intrinsics.sensor] = CalibratedIntrinsics(
                model=intrinsics.camera.distortion.ros_name,
                parameters=intrinsics.free,
                values=values[i][intrinsics.at],
                covariance=covariance.get(i, np.full((k, k), np.nan)),
            )
    return found


def covariances_of_transforms(setup: Setup, covariance: Mapping[int, Array]) -> dict[Edge, Array]:
    """Return the covariances of the shared poses; those of patterns in their own frame, not at their centre."""
    blocks = setup.problem.blocks
    found = {
        edge: C for i, C in covariance.items() if isinstance(blocks[i].parameters, Pose) and (edge := blocks[i].edge)
    }
    for pattern in setup.dataset.patterns.values():
        if (edge := pattern.edge) in found:
            to_frame = adjoint(translation(pattern.centre))
            found[edge] = to_frame @ found[edge] @ to_frame.T
    return found


def view_residuals(setup: Setup, values: Values) -> tuple[ViewResiduals, ...]:
    """Return the residuals of all labels."""
    keys = setup.dataset.keys
    residuals = []
    for group in setup.problem.groups:
        T = setup.problem.poses(group, values)
        collections = tuple(keys[i] for i in group.collections.tolist())
        residuals += [
            ViewResiduals(group.sensor, group.pattern, term.kind, collections, term.magnitudes(T))
            for term in setup.problem.terms(group, values)
        ]
    return tuple(residuals)


def rejected_labels(
    dataset: Dataset, residuals: Sequence[ViewResiduals], weighting: Weighting
) -> tuple[RejectedLabel, ...]:
    """Return the labels that the robust loss gives less than half their weight; none without such a loss."""
    huber = weighting.huber
    if huber is None:
        return ()
    labels = {collection.key: collection.labels for collection in dataset.collections}
    rejected = []
    for r in residuals:
        with np.errstate(invalid="ignore"):
            beyond = r.magnitudes > 2 * huber * weighting.scales[r.kind]
        for v, k in zip(*np.nonzero(beyond), strict=True):
            view, magnitude = labels[r.collections[v]][r.pattern, r.sensor], float(r.magnitudes[v, k])
            label = int(view.limits[k] if isinstance(view, PointLabels) and r.kind in BORDER_NOISE_KINDS else k)
            rejected.append(RejectedLabel(r.collections[v], r.sensor, r.pattern, r.kind, label, magnitude))
    return tuple(sorted(rejected, key=lambda label: (label.collection, label.sensor, label.label, label.kind)))
