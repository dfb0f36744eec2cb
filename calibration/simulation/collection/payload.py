"""The files beside a dataset: images, depth images and point clouds."""

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.dataset.configuration import SensorConfiguration
from calibration.dataset.pointcloud import encode_pcd
from calibration.simulation.collection.capture import Capture

JPEG_QUALITY = 88
_ENDINGS = {"rgb": "jpg", "lidar3d": "pcd", "depth": "png"}


def data_file(sensor: SensorConfiguration, collection: str) -> str:
    """The name of the file with a sensor's data in a collection."""
    return f"{sensor.name}_{collection}.{_ENDINGS[sensor.modality]}"


def encode(capture: Capture, sensor: str) -> bytes:
    """The content of a sensor's file: JPEG, PNG of 16 bits, or binary PCD."""
    if sensor in capture.images:
        return _encoded(".jpg", capture.images[sensor], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if sensor in capture.depths:
        return _encoded(".png", capture.depths[sensor], [cv2.IMWRITE_PNG_COMPRESSION, 6])
    return encode_pcd(capture.clouds[sensor])


def _encoded(ending: str, image: NDArray[np.uint8] | NDArray[np.uint16], options: list[int]) -> bytes:
    done, data = cv2.imencode(ending, image, options)
    if not done:
        raise AssertionError(f"OpenCV cannot write {ending}")
    return bytes(data)
