"""Read and write ``intrinsics.json``: calibrated intrinsics with their covariance, for another calibration.

``{"cameras": {"left": {"model": "plumb_bob", "parameters": ["fx", ...], "values": [...], "covariance": [[...]],
"camera_info": {...}}}}``, pixels for fx, fy, cx and cy. An import takes all of it from there, a calibration the
covariance.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration.base.files import write_atomically
from calibration.engine.dataset.document import Node, read_json
from calibration.engine.dataset.lens_uncertainty import read_covariance, read_parameters
from calibration.engine.dataset.sensors import MAX_INTRINSIC, camera_document
from calibration.engine.estimation.problem.intrinsics import PARAMETERS_IN_PIXELS, CalibratedIntrinsics
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
