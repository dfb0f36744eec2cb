"""Sensors of a dataset: frames, calibrated transforms and intrinsics, checked against the configuration.

How well a camera's intrinsics are known is in the key ``uncertainty`` of its camera_info, where their own calibration
says so: ``{"parameters": ["fx", ...], "covariance": [[...]]}``, or ``"standard_deviations": [...]`` in its place,
pixels for fx, fy, cx and cy. Standard deviations alone are those of OpenCV: by the noise of the corners.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import SensorConfiguration
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.modalities import MODALITIES
from calibration.engine.dataset.model import LensUncertainty, Sensor
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS, SYNONYMS, Distortion, PlumbBob

MAX_PIXELS = 1 << 20
"""px: limit of the width or height of an image."""
MAX_INTRINSIC = 1e7
"""Limit of focal length, principal point (px) and distortion coefficients."""
MAX_LEAN = 0.1
"""Limit of a skew over ``fy``: columns that lean by more are no camera's."""
LAG_KEY = "lag"
"""Key of a sensor: its lag, s."""
MAX_LAG = 1.0
"""s: limit of a lag; the velocity at a moment says nothing of what is farther away."""
BINNING_KEYS = ("binning_x", "binning_y")
MAX_BINNING = 64
_CONFIGURATION_KEY_OF = {
    "modality": "modality",
    "parent": "link",
    "calibration_parent": "parent_link",
    "calibration_child": "child_link",
}
"""Keys of a sensor, and the keys of its configuration with the same meaning."""


def read_sensors(node: Node, configuration: Mapping[str, SensorConfiguration]) -> dict[str, Sensor]:
    """Parse the sensors of a dataset's ``sensors``.

    Raises:
        InputError: something in it is missing or wrong, or it differs from the configuration.
    """
    for name in configuration:
        if name not in node.mapping():
            raise node.fault(f"missing sensor '{name}' of calibration_config/sensors")
    sensors = {}
    for name, entry in node.items():
        if name not in configuration:
            raise entry.fault(f"sensor '{name}' is missing in calibration_config/sensors")
        modality = MODALITIES.get(entry["modality"].text())
        if modality is None:
            raise entry["modality"].unexpected(f"a known modality of sensor '{name}': {', '.join(MODALITIES)}")
        for key, twin in _CONFIGURATION_KEY_OF.items():
            if entry[key].name() != (expected := getattr(configuration[name], twin)):
                raise entry[key].unexpected(f"'{expected}' as in calibration_config/sensors/{name}/{twin}")
        sensors[name] = Sensor(
            name=name,
            modality=modality,
            frame=entry["parent"].value,
            calibration_parent=entry["calibration_parent"].value,
            calibration_child=entry["calibration_child"].value,
            camera=(camera := read_camera(entry["camera_info"]) if modality.has_intrinsics else None),
            uncertainty=read_uncertainty(known, camera.parameters)
            if camera and (known := entry["camera_info"].get(UNCERTAINTY_KEY))
            else None,
            lag=lag.within(-MAX_LAG, MAX_LAG) if (lag := entry.get(LAG_KEY)) else 0.0,
        )
    return sensors


def read_camera(info: Node) -> Camera:
    """Parse the intrinsics of a sensor_msgs/CameraInfo: K, D and the size of the image.

    K is that of the whole image sensor; of an image that is a part (``roi``) or a reduction (``binning``) of it, the
    intrinsics are those of the image, as REP 104 has it.

    Raises:
        InputError: something in it is missing or wrong, or its distortion model is not known.
    """
    width, height = info["width"].whole(1, MAX_PIXELS), info["height"].whole(1, MAX_PIXELS)
    fx, skew, cx, zero, fy, cy, *bottom = info["K"].numbers(9)
    if max(fx, fy, abs(cx), abs(cy)) > MAX_INTRINSIC:
        raise info["K"].fault(f"found {info['K'].value}, expected numbers of pixels up to {MAX_INTRINSIC:g}")
    if not (fx > 0 and fy > 0 and zero == 0 and bottom == [0, 0, 1]):
        raise info["K"].fault(f"found {info['K'].value}, expected [fx, skew, cx, 0, fy, cy, 0, 0, 1] with fx, fy > 0")
    if abs(skew) > MAX_LEAN * fy:
        raise info["K"].fault(f"found a skew of {skew:g}, expected {MAX_LEAN:g} of fy, {fy:g}, at most")
    camera = Camera(fx, fy, cx, cy, width, height, _read_distortion(info), skew)
    return _of_image(camera, info)


def _of_image(camera: Camera, info: Node) -> Camera:
    """Return the camera of the part of the image sensor that is read, with the pixels that are added up (REP 104)."""
    x, width = _axis_extent(info, "x_offset", "width", camera.width)
    y, height = _axis_extent(info, "y_offset", "height", camera.height)
    columns, rows = (max(1, each.whole(0, MAX_BINNING)) if (each := info.get(key)) else 1 for key in BINNING_KEYS)
    return replace(
        camera,
        fx=camera.fx / columns,
        fy=camera.fy / rows,
        cx=(camera.cx - x) / columns,
        cy=(camera.cy - y) / rows,
        width=width // columns,
        height=height // rows,
        skew=camera.skew / columns,
    )


def _axis_extent(info: Node, offset: str, length: str, whole: int) -> tuple[int, int]:
    """Return the offset and the length of an image along one axis of the sensor; a length of 0 is the whole."""
    roi = info.get("roi")
    begin = each.whole(0, whole - 1) if roi and (each := roi.get(offset)) else 0
    part = each if roi and (each := roi.get(length)) and each.number() != 0 else None
    return begin, part.whole(1, whole - begin) if part else whole - begin


def check_principal_point(camera: Camera, where: str) -> None:
    """Refuse a principal point outside of the image: the intrinsics are those of another resolution.

    Raises:
        InputError: it is outside.
    """
    if not (0 <= camera.cx <= camera.width and 0 <= camera.cy <= camera.height):
        raise InputError(
            f"{where}: found the principal point ({camera.cx:g}, {camera.cy:g}) outside of the image of {camera.width} "
            f"x {camera.height} pixels: is it of another resolution?"
        )


def camera_document(camera: Camera) -> dict[str, Any]:
    """Return the CameraInfo fields that `read_camera` reads: size, model, D, K and P."""
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    return {
        "height": camera.height,
        "width": camera.width,
        "distortion_model": camera.distortion.ros_name,
        "D": camera.distortion.coefficients.tolist(),
        "K": [fx, camera.skew, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "P": [fx, camera.skew, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }


def _read_distortion(info: Node) -> Distortion:
    name, D = info["distortion_model"], info["D"]
    coefficients = [element.within(-MAX_INTRINSIC, MAX_INTRINSIC) for element in D.elements()]
    if name.text() in ("", "none") and not any(coefficients):
        return PlumbBob()
    found = SYNONYMS.get(name.value, name.value)
    if found not in MODELS:
        raise name.unexpected(f"a known distortion model: {', '.join((*MODELS, *SYNONYMS))}")
    model = MODELS[found]
    count = len(model.names())
    if len(coefficients) < model.min_coefficients:
        raise D.unexpected(f"at least {model.min_coefficients} coefficients of {found}: {', '.join(model.names())}")
    for coefficient, value in zip(model.names(), coefficients, strict=False):
        low, high = model.limits.get(coefficient, (-MAX_INTRINSIC, MAX_INTRINSIC))
        if not low <= value <= high:
            raise D.unexpected(f"{coefficient} of {found} from {low:g} to {high:g}; D is {', '.join(model.names())}")
    if any(coefficients[count:]):
        longer = [each.ros_name for each in MODELS.values() if len(each.names()) >= len(coefficients)]
        hint = f"; {longer[0]} has as many" if longer else ""
        raise D.unexpected(f"{count} coefficients of {model.ros_name}: {', '.join(model.names())}{hint}")
    return model(*coefficients[:count])


UNCERTAINTY_KEY = "uncertainty"
MAX_ASYMMETRY = 1e-6
"""Tolerance of the symmetry of correlations: files are rounded."""
MIN_VARIANCE = 1e-200
"""Lower limit of a variance."""
MIN_EIGENVALUE = 1e-13
"""Lower limit of the correlations' smallest eigenvalue, due to rounding."""


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
