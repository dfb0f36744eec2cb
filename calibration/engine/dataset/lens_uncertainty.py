"""How well a camera's intrinsics are known, where their own calibration says so: key ``uncertainty`` of camera_info.

``{"parameters": ["fx", ...], "covariance": [[...]]}``, or ``"standard_deviations": [...]`` in its place, pixels for fx,
fy, cx and cy. Standard deviations alone are those of OpenCV: by the noise of the corners.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node

UNCERTAINTY_KEY = "uncertainty"
MAX_ASYMMETRY = 1e-6
"""Tolerance of the symmetry of correlations: files are rounded."""
MIN_VARIANCE = 1e-200
"""Lower limit of a variance."""
MIN_EIGENVALUE = 1e-13
"""Lower limit of the correlations' smallest eigenvalue, due to rounding."""


@dataclass(frozen=True, eq=False)
class LensUncertainty:
    """Covariance, or only standard deviations, of some intrinsics."""

    parameters: tuple[str, ...]
    """k of `calibration.engine.geometry.cameras.Camera.parameters`, in this order."""
    sigmas: Array
    """(k,): px, and 1; above 0."""
    covariance: Array | None = None
    """(k, k); None if only the standard deviations are known."""


def read_uncertainty(node: Node, known: tuple[str, ...]) -> LensUncertainty:
    """Parse the value of `UNCERTAINTY_KEY`.

    Args:
        node: the value.
        known: names of the camera's parameters.

    Raises:
        InputError: something in it is missing or wrong.
    """
    parameters = read_parameters(node["parameters"], known)
    if (covariance := node.get("covariance")) is not None:
        C = read_covariance(covariance, len(parameters))
        return LensUncertainty(parameters, np.sqrt(np.diagonal(C)), C)
    sigmas = node["standard_deviations"]
    sigmas.numbers(len(parameters))
    return LensUncertainty(parameters, np.array([each.within(1e-100, 1e7) for each in sigmas.elements()]))


def uncertainty_document(uncertainty: LensUncertainty) -> dict[str, Any]:
    """Return the value of `UNCERTAINTY_KEY`."""
    document: dict[str, Any] = {"parameters": list(uncertainty.parameters)}
    if uncertainty.covariance is not None:
        return {**document, "covariance": uncertainty.covariance.tolist()}
    return {**document, "standard_deviations": uncertainty.sigmas.tolist()}


def read_parameters(node: Node, known: tuple[str, ...]) -> tuple[str, ...]:
    """Parse the names of some parameters, each once.

    Raises:
        InputError: there are none, or one is unknown or repeated.
    """
    parameters: list[str] = []
    for element in node.elements():
        if element.name() not in known or element.value in parameters:
            raise element.unexpected(f"one of {', '.join(known)}, each once")
        parameters.append(element.value)
    if not parameters:
        raise node.unexpected(f"some of {', '.join(known)}")
    return tuple(parameters)


def read_covariance(node: Node, count: int) -> Array:
    """Parse a covariance (count, count).

    Raises:
        InputError: it has another size, or is none.
    """
    if len(node.sequence()) != count:
        raise node.unexpected(f"{count} rows, one for each parameter")
    C = np.array([row.numbers(count) for row in node.elements()])
    variances = np.diagonal(C)
    if (variances < MIN_VARIANCE).any():
        k = int((variances < MIN_VARIANCE).argmax())
        raise node.fault(f"found the variance {variances[k]:g} in row {k}, expected one above 0")
    sigma = np.sqrt(variances)
    with np.errstate(over="ignore", invalid="ignore"):
        correlation = C / sigma[:, None] / sigma
        symmetric = np.abs(correlation - correlation.T).max() <= MAX_ASYMMETRY
    if not symmetric:
        raise node.fault("found a matrix that is not symmetric, expected a covariance")
    correlation = 0.5 * (correlation + correlation.T)
    if not np.linalg.eigvalsh(correlation)[0] > MIN_EIGENVALUE:
        raise node.fault("found a matrix that is not positive definite, expected a covariance")
    return np.asarray(correlation * sigma[:, None] * sigma)
