"""The file ``calibration-reference.json``: what each fixed camera saw when its calibration was accepted.

Features and their places, no images: some ten kilobytes a camera. It is kept in git beside the baseline.
"""

import base64
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from calibration.addons.guard.features import DESCRIPTOR_SIZE, MAX_KEPT, Features
from calibration.base import InputError, parse_json, read_bytes
from calibration.base.records import Misfit, at_least, between, field, length, matching, read, record, text_of
from calibration.engine.baseline.calibration_document import Name, Number
from calibration.engine.estimation.options import LensModel
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS

REFERENCE_FILE = "calibration-reference.json"
MAX_REFERENCE_BYTES = 32_000_000
DESCRIPTOR_SCALE = 512
"""An element of a descriptor as a byte, as SIFT has them."""
Pixels = Annotated[int, between(1, 100_000)]
Base64 = Annotated[str, length(0, 4 * MAX_KEPT * DESCRIPTOR_SIZE)]


@record(kw_only=True)
class KeptCamera:
    """A camera, and what it saw."""

    system: Name = field("Its system in the baseline.")
    sensor: Name = field("Its name there.")
    data: Annotated[str, matching("[0-9a-f]{64}", "64 hexadecimal digits")] = field(
        "SHA-256 of the labels of the accepted calibration."
    )
    place: Name = field("Topic, folder or file of its images.")
    width: Pixels = field("Of its images.", unit="px")
    height: Pixels = field("Of its images.", unit="px")
    model: LensModel = field("Lens model, as ROS names it.")
    intrinsics: Annotated[tuple[Number, ...], length(4, 40)] = field(
        "fx, fy, cx, cy and the coefficients, as accepted."
    )
    skew: Number = field("Lean of a pixel column.", unit="px", default=0.0)
    images: Annotated[int, at_least(1)] = field("Images that were looked at.")
    sharpness: Annotated[float, between(0, 1000)] = field("Median sharpness at the features.")
    pixels: Base64 = field("Places of the features: pairs of float32, little endian, in base64.")
    descriptors: Base64 = field("Their descriptors: 128 bytes each, in base64.")

    def __post_init__(self) -> None:
        """Refuse arrays that do not fit together.

        Raises:
            Misfit: names the key.
        """
        pixels = _bytes_of(self.pixels, "pixels", 8)
        if not np.isfinite(np.frombuffer(pixels, "<f4")).all():
            raise Misfit("found a number that is not finite", "pixels")
        if 16 * len(pixels) != len(_bytes_of(self.descriptors, "descriptors", DESCRIPTOR_SIZE)):
            raise Misfit(f"expected as many as pixels, {len(pixels) // 8}", "descriptors")
        if len(self.intrinsics) != len(self.camera.parameters) or min(self.intrinsics[:2]) <= 0:
            raise Misfit(f"expected {', '.join(self.camera.parameters)}, with focal lengths above 0", "intrinsics")

    @property
    def camera(self) -> Camera:
        """The camera with its accepted intrinsics."""
        lens = MODELS[self.model]()
        plain = Camera(1.0, 1.0, 0.0, 0.0, self.width, self.height, lens, self.skew)
        return plain.with_intrinsics(np.array(self.intrinsics))

    @property
    def features(self) -> Features:
        """The features, at least once with their descriptors."""
        pixels = np.frombuffer(base64.b64decode(self.pixels), "<f4").reshape(-1, 2).astype(float)
        values = (
            np.frombuffer(base64.b64decode(self.descriptors), np.uint8).reshape(-1, DESCRIPTOR_SIZE).astype(np.float32)
        )
        return Features(pixels, values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-6))


@record
class Reference:
    """What fixed cameras saw when their calibration was accepted."""

    version: Literal[1] = field("Version of this format.")
    cameras: Annotated[tuple[KeptCamera, ...], length(0, 1000)] = field("The cameras.")

    def updated(self, cameras: tuple[KeptCamera, ...]) -> "Reference":
        """Return it with other or further cameras."""
        known = {(each.system, each.sensor): each for each in (*self.cameras, *cameras)}
        return replace(self, cameras=tuple(known[key] for key in sorted(known)))

    @property
    def text(self) -> str:
        """The document."""
        return text_of(self)


def encoded_features(features: Features) -> tuple[str, str]:
    """Return the places and the descriptors of features in base64."""
    values = np.clip(np.round(features.descriptors * DESCRIPTOR_SCALE), 0, 255).astype(np.uint8)
    return _text_of_array(features.pixels.astype("<f4")), _text_of_array(values)


def read_reference(path: Path) -> Reference | None:
    """Read a reference; None if there is none.

    Raises:
        InputError: it is not valid; names file and key.
    """
    if path.is_symlink():
        raise InputError(f"{path}: found a symbolic link, expected the reference itself")
    if not path.exists():
        return None
    try:
        document = parse_json(read_bytes(path, MAX_REFERENCE_BYTES, "a reference"), finite=True)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: this is not a reference: {error}") from None
    return read(Reference, document, str(path))


def _text_of_array(values: np.ndarray) -> str:
    return base64.b64encode(values.tobytes()).decode()


def _bytes_of(text: str, key: str, size: int) -> bytes:
    try:
        found = base64.b64decode(text, validate=True)
    except ValueError:  # of binascii too, and of letters beyond ASCII
        raise Misfit("found no base64, expected it", key) from None
    if len(found) % size or len(found) > MAX_KEPT * size:
        raise Misfit(f"found {len(found)} bytes, expected {size} for each of at most {MAX_KEPT} features", key)
    return found
