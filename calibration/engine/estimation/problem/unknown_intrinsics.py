"""Blocks of intrinsics that are calibrated, or known with a covariance."""

from collections.abc import Mapping, Sequence

import numpy as np

from calibration.base.arrays import Array
from calibration.base.errors import InputError
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.estimation.problem.blocks import Block, Values
from calibration.engine.estimation.problem.intrinsics import ALL_CAMERAS, CalibratedIntrinsics, FreeIntrinsics, Prior
from calibration.engine.geometry.cameras import Camera

MIN_SIGMAS_OF_CONTRADICTION = 6
"""A prior is contradicted if its distance from the result exceeds the expected one by this, in standard deviations."""


def intrinsics_blocks(
    dataset: Dataset, wanted: Sequence[str], known: Mapping[str, CalibratedIntrinsics]
) -> tuple[Block, ...]:
    """Return a block for each camera with intrinsics to calibrate, or with a given covariance.

    With a covariance alone the intrinsics are fixed, and their covariance is considered
    (`calibration.engine.estimation.covariance.lens_errors`). With both, the covariance is a prior.

    Args:
        dataset: the dataset.
        wanted: names of rgb sensors, or "all".
        known: by sensor; it may have sensors that are not in the dataset.

    Raises:
        InputError: a sensor is unknown or not an rgb camera; none of the known cameras exists, or one has another
            distortion model.
    """
    cameras = {name: each for name, each in dataset.sensors.items() if each.modality.has_corners and each.camera}
    for name in wanted:
        if name != ALL_CAMERAS and name not in cameras:
            what = f"a {dataset.sensors[name].modality} sensor" if name in dataset.sensors else "no sensor"
            raise InputError(
                f"{dataset.path}: intrinsics: '{name}' is {what}, expected {ALL_CAMERAS} or cameras "
                f"({', '.join(cameras) or 'there are none'})"
            )
    if known and not known.keys() & cameras.keys():
        raise InputError(
            f"{dataset.path}: intrinsics-covariance: it is of {', '.join(known)}, expected one of the cameras "
            f"({', '.join(cameras) or 'there are none'})"
        )
    blocks = []
    for name, sensor in cameras.items():
        chosen = name in wanted or ALL_CAMERAS in wanted
        if sensor.camera and (chosen or name in known):
            prior = _prior_of_camera(dataset, name, sensor.camera, known[name], chosen) if name in known else None
            free = sensor.camera.parameters if chosen else ()
            intrinsics = FreeIntrinsics(
                name, sensor.camera, free, _labels_in_chart(dataset, name, sensor.camera), prior
            )
            blocks.append(Block(f"intrinsics-{name}", held=not chosen, parameters=intrinsics))
    return tuple(blocks)


def contradicted_priors(blocks: Sequence[Block], values: Values) -> list[str]:
    """Return a warning for each camera whose labels contradict the prior.

    The squared Mahalanobis distance of the result from a prior of u parameters is at most that of chi-squared with
    u degrees of freedom, whose mean is u and whose variance is 2 u.
    """
    warnings = []
    for block, value in zip(blocks, values, strict=True):
        if (intrinsics := block.intrinsics) and not block.held and (prior := intrinsics.prior):
            squared, count = intrinsics.pull(value)[0], len(prior.at)
            if squared > count + MIN_SIGMAS_OF_CONTRADICTION * np.sqrt(2 * count):
                off = (value[list(prior.at)] - prior.mean) / np.sqrt(np.diagonal(prior.covariance))
                k = int(np.abs(off).argmax())
                warnings.append(
                    f"'{block.name}': the labels contradict the given covariance: "
                    f"{intrinsics.camera.parameters[prior.at[k]]} comes out {abs(off[k]):.0f} standard deviations from "
                    f"the {prior.mean[k]:.6g} that was given"
                )
    return warnings


def _prior_of_camera(
    dataset: Dataset, name: str, camera: Camera, known: CalibratedIntrinsics, calibrated: bool
) -> Prior:
    where = f"{dataset.path}: covariance of the intrinsics of '{name}'"
    if known.model != camera.distortion.ros_name:
        raise InputError(f"{where}: it is of a lens {known.model}, the dataset has {camera.distortion.ros_name}")
    for parameter in known.parameters:
        if parameter not in camera.parameters:
            raise InputError(f"{where}: found '{parameter}', expected some of {', '.join(camera.parameters)}")
    at = [camera.parameters.index(parameter) for parameter in known.parameters]
    order = np.argsort(at)
    off = np.abs(camera.intrinsics[at] - known.values) / known.sigmas
    if not calibrated and (off > 1).any():
        worst = int(off.argmax())
        raise InputError(
            f"{where}: it is of {known.parameters[worst]} = {known.values[worst]:.6g}, more than a standard deviation "
            f"from the {camera.intrinsics[at[worst]]:.6g} of the dataset; take the camera_info that it belongs to, "
            f"or calibrate these intrinsics"
        )
    return Prior(tuple(sorted(at)), known.values[order], known.covariance[np.ix_(order, order)])


def _labels_in_chart(dataset: Dataset, name: str, camera: Camera) -> Array:
    """Return the labels of a camera in its lens's chart (2, n), without those that have none."""
    labels = [c.labels[key] for c in dataset.collections for key in c.labels if key[1] == name]
    pixels = [each.pixels for each in labels if isinstance(each, CornerLabels)]
    rays = np.stack(camera.from_pixels(*np.concatenate(pixels).T))
    return rays[:, np.isfinite(rays[0])]
