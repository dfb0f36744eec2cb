"""Sensors of a dataset: frames, calibrated transforms and intrinsics, checked against the configuration."""

from collections.abc import Mapping
from typing import Any

from calibration.dataset.configuration import SensorConfiguration
from calibration.dataset.document import Node
from calibration.dataset.lens_uncertainty import KEY as UNCERTAINTY
from calibration.dataset.lens_uncertainty import LensUncertainty, read_uncertainty
from calibration.dataset.modalities import MODALITIES
from calibration.dataset.model import Sensor
from calibration.geometry.cameras import Camera
from calibration.geometry.distortion import MODELS, Distortion, PlumbBob

MAX_PIXELS = 1 << 20
"""px: limit of the width or height of an image."""
MAX_INTRINSIC = 1e7
"""Limit of focal length, principal point (px) and distortion coefficients."""
_TWINS = {
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
        for key, twin in _TWINS.items():
            if entry[key].name() != (expected := getattr(configuration[name], twin)):
                raise entry[key].unexpected(f"'{expected}' as in calibration_config/sensors/{name}/{twin}")
        sensors[name] = Sensor(
            name=name,
            modality=modality,
            frame=entry["parent"].value,
            calibration_parent=entry["calibration_parent"].value,
            calibration_child=entry["calibration_child"].value,
            camera=(camera := read_camera(entry["camera_info"]) if modality.has_intrinsics else None),
            uncertainty=_read_uncertainty(entry["camera_info"], camera) if camera else None,
        )
    return sensors


def _read_uncertainty(info: Node, camera: Camera) -> LensUncertainty | None:
    found = info.get(UNCERTAINTY)
    return None if found is None else read_uncertainty(found, camera.parameters)


def read_camera(info: Node) -> Camera:
    """Parse the intrinsics of a sensor_msgs/CameraInfo: K, D and the size of the image.

    Raises:
        InputError: something in it is missing or wrong, its distortion model is not known, or the image is a part
            (``roi``) or a reduction (``binning``) of what K describes.
    """
    width, height = info["width"].whole(1, MAX_PIXELS), info["height"].whole(1, MAX_PIXELS)
    _refuse_binning(info, width, height)
    fx, skew, cx, zero, fy, cy, *bottom = info["K"].numbers(9)
    if max(fx, fy, abs(cx), abs(cy)) > MAX_INTRINSIC:
        raise info["K"].fault(f"found {info['K'].value}, expected numbers of pixels up to {MAX_INTRINSIC:g}")
    if not (fx > 0 and fy > 0 and skew == zero == 0 and bottom == [0, 0, 1]):
        raise info["K"].fault(f"found {info['K'].value}, expected [fx, 0, cx, 0, fy, cy, 0, 0, 1] with fx, fy > 0")
    return Camera(
        fx=fx,
        fy=fy,
        cx=cx,
        cy=cy,
        width=width,
        height=height,
        distortion=_read_distortion(info),
    )


def _refuse_binning(info: Node, width: int, height: int) -> None:
    """Refuse an image with roi or binning: in CameraInfo, K is of the full image without binning."""
    for key in ("binning_x", "binning_y"):
        if (binning := info.get(key)) and binning.number() not in (0, 1):
            raise binning.unexpected("0 or 1: K, width and height of the image as it is, without binning")
    if roi := info.get("roi"):
        for key, whole in (("x_offset", 0), ("y_offset", 0), ("width", width), ("height", height)):
            if (part := roi.get(key)) and part.number() not in (0, whole):
                raise part.unexpected(f"{f'0 or {whole}' if whole else '0'}: K of the image as it is, without a roi")


def camera_document(camera: Camera) -> dict[str, Any]:
    """Return the CameraInfo fields that `read_camera` reads: size, model, D, K and P."""
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    return {
        "height": camera.height,
        "width": camera.width,
        "distortion_model": camera.distortion.ros_name,
        "D": camera.distortion.coefficients.tolist(),
        "K": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "P": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }


def _read_distortion(info: Node) -> Distortion:
    name, D = info["distortion_model"], info["D"]
    coefficients = [element.within(-MAX_INTRINSIC, MAX_INTRINSIC) for element in D.elements()]
    if name.text() == "" and not any(coefficients):
        return PlumbBob()
    if name.value not in MODELS:
        raise name.unexpected(f"a known distortion model: {', '.join(MODELS)}")
    model = MODELS[name.value]
    if len(coefficients) > len(model.names()):
        raise D.unexpected(f"{len(model.names())} coefficients of {model.ros_name}: {', '.join(model.names())}")
    return model(*coefficients)
