"""Intrinsics with a covariance: those of cameras in a problem, and the file ``intrinsics.json`` of a result.

``{"cameras": {"left": {"model": "plumb_bob", "parameters": ["fx", ...], "values": [...], "covariance": [[...]],
"camera_info": {...}}}}``, pixels for fx, fy, cx and cy. An import takes all of it from there, a calibration the
covariance.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calibration.base import InputError, write_atomically
from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node, read_json
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.sensors import MAX_INTRINSIC, camera_document, read_covariance, read_parameters
from calibration.engine.estimation.problem.blocks import (
    ALL_CAMERAS,
    PARAMETERS_IN_PIXELS,
    Block,
    CalibratedIntrinsics,
    FreeIntrinsics,
    Prior,
    Values,
)
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS

FILE_NAME = "intrinsics.json"
MAX_CAMERAS = 1000
MAX_BYTES = 1 << 24
"""Limit of the file's size in bytes."""


def write_intrinsics(path: Path, intrinsics: Mapping[str, CalibratedIntrinsics], cameras: Mapping[str, Camera]) -> None:
    """Write the intrinsics of cameras, by sensor.

    Args:
        path: of the file.
        intrinsics: what was calibrated.
        cameras: the same cameras, with what was not.

    Raises:
        InfrastructureError: the file cannot be written.
    """
    documents = {
        name: {
            "model": each.model,
            "parameters": list(each.parameters),
            "values": each.values.tolist(),
            "covariance": each.covariance.tolist(),
            "camera_info": camera_document(cameras[name]),
        }
        for name, each in intrinsics.items()
    }
    write_atomically(path, json.dumps({"cameras": documents}, indent=1, allow_nan=False) + "\n")


def read_intrinsics(path: Path) -> dict[str, CalibratedIntrinsics]:
    """Read the file of `write_intrinsics`, or an equivalent one.

    Raises:
        InputError: the file cannot be read, or something in it is missing or wrong; names file and key.
    """
    cameras = read_json(path, MAX_BYTES)["cameras"]
    if not 0 < len(cameras.mapping()) <= MAX_CAMERAS:
        raise cameras.unexpected(f"1 to {MAX_CAMERAS} cameras")
    return {name: read_calibrated(node) for name, node in cameras.items()}


def read_calibrated(node: Node) -> CalibratedIntrinsics:
    """Parse the entry of one camera.

    Raises:
        InputError: something in it is missing or wrong.
    """
    model = node["model"]
    if model.text() not in MODELS:
        raise model.unexpected(f"a known distortion model: {', '.join(MODELS)}")
    known = (*PARAMETERS_IN_PIXELS, *MODELS[model.value].names())
    parameters = read_parameters(node["parameters"], known)
    node["values"].numbers(len(parameters))
    values = np.array([element.within(-MAX_INTRINSIC, MAX_INTRINSIC) for element in node["values"].elements()])
    return CalibratedIntrinsics(model.value, parameters, values, read_covariance(node["covariance"], len(parameters)))


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
