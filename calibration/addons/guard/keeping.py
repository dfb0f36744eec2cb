"""``accept --reference``: keeps what fixed cameras see, beside the baseline."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np

from calibration.addons.guard.features import (
    REFERENCE_FILE,
    KeptCamera,
    Reference,
    encoded_features,
    read_reference,
    sharpness_at,
    stable_features,
)
from calibration.addons.guard.fixed_check import check_fixed_camera
from calibration.addons.guard.recording import CameraImages, camera_named, no_such_camera, open_recordings
from calibration.base import InputError
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.options import LensModel
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS
from calibration.pipeline.baselines import AcceptedSystems
from calibration.robot.labelling.detection import Image

MAX_REFERENCE_IMAGES = 30
SHARPNESS_IMAGES = 5


def kept_references(recordings: Sequence[str], accepted: AcceptedSystems) -> dict[Path, str]:
    """Return the reference of accepted systems, by its path.

    Args:
        recordings: bags, videos and folders in which nothing of the cameras moves, see `open_recordings`.
        accepted: the systems.

    Raises:
        InputError: a recording cannot be read, or a camera moves in it, or none of the cameras is in it.
    """
    cameras = {
        (system, name): accepted_camera(camera, accepted.baseline.systems[system], name)
        for system, dataset in accepted.datasets.items()
        for name, sensor in read_dataset(dataset).sensors.items()
        if (camera := sensor.camera) is not None
    }
    found = open_recordings(recordings)
    kept = []
    for (system, name), camera in cameras.items():
        if (images := camera_named(found, name, None, len(cameras))) is not None:
            kept.append(kept_camera(system, name, camera, images, accepted.baseline.systems[system].data))
    if not kept:
        raise InputError(f"{recordings[0]}: {no_such_camera(found, ', '.join(name for _, name in cameras))}")
    path = accepted.file.with_name(REFERENCE_FILE)
    return {path: (read_reference(path) or Reference(1, ())).updated(tuple(kept)).text}


def accepted_camera(camera: Camera, accepted: CalibrationDocument, name: str) -> Camera:
    """Return a camera with its accepted intrinsics, if these were calibrated."""
    if (lens := accepted.lens(name)) is None:
        return camera
    parameters, values, _ = lens
    models = [camera.distortion, *(model() for model in MODELS.values())]
    plain = next(found for each in models if (found := replace(camera, distortion=each)).parameters == parameters)
    return plain.with_intrinsics(values)


def kept_camera(system: str, sensor: str, camera: Camera, images: CameraImages, data: str) -> KeptCamera:
    """Return what a camera sees over a recording.

    Args:
        system: its system.
        sensor: its name.
        camera: its accepted intrinsics.
        images: of the recording.
        data: SHA-256 of the labels of the accepted calibration.

    Raises:
        InputError: the images cannot be read, have another size, or tell nothing of the camera, or it moves.
    """

    def checked() -> Iterator[Image]:
        for _, image in images.read(0.0, images.seconds, MAX_REFERENCE_IMAGES):
            if image.shape != (camera.height, camera.width):
                raise InputError(
                    f"{images.place}: found images of {image.shape[1]} x {image.shape[0]} pixels, expected "
                    f"{camera.width} x {camera.height} as the accepted calibration of '{sensor}' has"
                )
            yield image

    features, number = stable_features(checked())
    few = images.read(0.0, images.seconds, SHARPNESS_IMAGES) if len(features) else ()
    sharpness = [sharpness_at(image, features.pixels) for _, image in few]
    pixels, descriptors = encoded_features(features)
    kept = KeptCamera(
        system=system,
        sensor=sensor,
        data=data,
        place=images.place,
        width=camera.width,
        height=camera.height,
        model=cast("LensModel", camera.distortion.ros_name),
        intrinsics=tuple(camera.intrinsics.tolist()),
        skew=camera.skew,
        images=number,
        sharpness=round(float(np.median(sharpness)), 4) if sharpness else 0.0,
        pixels=pixels,
        descriptors=descriptors,
    )
    found = check_fixed_camera(kept, images)
    if found.outcome != "unmoved":
        raise InputError(f"{images.place}: '{sensor}' has no reference in it: {found.reason}")
    return kept
