"""Read and write ``intrinsics.json``: calibrated intrinsics with their covariance, as a prior of another calibration.

``{"cameras": {"left": {"model": "plumb_bob", "parameters": ["fx", ...], "values": [...], "covariance": [[...]]}}}``,
pixels for fx, fy, cx and cy.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration.dataset.document import Node, read_json
from calibration.dataset.sensors import MAX_INTRINSIC
from calibration.estimation.intrinsics import PIXELS, CalibratedIntrinsics
from calibration.files import write_atomically
from calibration.geometry.distortion import MODELS
from calibration.geometry.types import Array

FILE_NAME = "intrinsics.json"
MAX_CAMERAS = 1000
MAX_BYTES = 1 << 24
"""Limit of the file's size in bytes."""
SYMMETRIC = 1e-6
"""Tolerance of the symmetry of correlations: files are rounded."""
TINY = 1e-200
"""Lower limit of a variance."""
DEFINITE = 1e-13
"""Lower limit of the correlations' smallest eigenvalue, due to rounding."""


def write_intrinsics(path: Path, intrinsics: Mapping[str, CalibratedIntrinsics]) -> None:
    """Write the intrinsics of cameras, by sensor.

    Raises:
        InfrastructureError: the file cannot be written.
    """
    cameras = {
        name: {
            "model": each.model,
            "parameters": list(each.parameters),
            "values": each.values.tolist(),
            "covariance": each.covariance.tolist(),
        }
        for name, each in intrinsics.items()
    }
    write_atomically(path, json.dumps({"cameras": cameras}, indent=1, allow_nan=False) + "\n")


def read_intrinsics(path: Path) -> dict[str, CalibratedIntrinsics]:
    """Read the file of `write_intrinsics`, or an equivalent one.

    Raises:
        InputError: the file cannot be read, or something in it is missing or wrong; names file and key.
    """
    cameras = read_json(path, MAX_BYTES)["cameras"]
    if not 0 < len(cameras.mapping()) <= MAX_CAMERAS:
        raise cameras.unexpected(f"1 to {MAX_CAMERAS} cameras")
    return {name: _camera(node) for name, node in cameras.items()}


def _camera(node: Node) -> CalibratedIntrinsics:
    model = node["model"]
    if model.text() not in MODELS:
        raise model.unexpected(f"a known distortion model: {', '.join(MODELS)}")
    known = (*PIXELS, *MODELS[model.value].names())
    parameters: list[str] = []
    for element in node["parameters"].elements():
        if element.name() not in known or element.value in parameters:
            raise element.unexpected(f"one of {', '.join(known)}, each once")
        parameters.append(element.value)
    if not parameters:
        raise node["parameters"].unexpected(f"some of {', '.join(known)}")
    node["values"].numbers(len(parameters))
    values = np.array([element.within(-MAX_INTRINSIC, MAX_INTRINSIC) for element in node["values"].elements()])
    return CalibratedIntrinsics(
        model.value, tuple(parameters), values, _covariance(node["covariance"], len(parameters))
    )


def _covariance(node: Node, count: int) -> Array:
    if len(node.sequence()) != count:
        raise node.unexpected(f"{count} rows, one for each parameter")
    C = np.array([row.numbers(count) for row in node.elements()])
    variances = np.diagonal(C)
    if (variances < TINY).any():
        k = int((variances < TINY).argmax())
        raise node.fault(f"found the variance {variances[k]:g} in row {k}, expected one above 0")
    sigma = np.sqrt(variances)
    with np.errstate(over="ignore", invalid="ignore"):
        correlation = C / sigma[:, None] / sigma
        symmetric = np.abs(correlation - correlation.T).max() <= SYMMETRIC
    if not symmetric:
        raise node.fault("found a matrix that is not symmetric, expected a covariance")
    correlation = 0.5 * (correlation + correlation.T)
    if not np.linalg.eigvalsh(correlation)[0] > DEFINITE:
        raise node.fault("found a matrix that is not positive definite, expected a covariance")
    covariance: Array = correlation * sigma[:, None] * sigma
    return covariance
