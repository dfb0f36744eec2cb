"""Intrinsics of a camera as a bag tells them: by the messages of its camera_info."""

from dataclasses import dataclass
from pathlib import PurePosixPath

from calibration.base.errors import InputError
from calibration.engine.geometry.cameras import Camera
from calibration.robot.importing.bags.bag import NS_PER_S, Bag, RawMessage
from calibration.robot.importing.bags.messages import CameraMessage, camera_of


def is_rectified(topic: str) -> bool:
    """Return whether images are rectified, by the name of their topic, as image_proc names them."""
    return any(part.startswith("image_rect") for part in PurePosixPath(topic).parts)


@dataclass
class RecordedLens:
    """Intrinsics of a camera_info topic, the same in all of its messages but those that are not calibrated."""

    topic: str
    _found: CameraMessage | None = None
    _content: bytes = b""
    """First calibrated message, without its stamp."""

    def add(self, bag: Bag, message: RawMessage) -> None:
        """Add a message.

        Raises:
            InputError: it is invalid, or has other intrinsics than one before it.
        """
        content = bag.without_stamp(message)
        if content == self._content:
            return
        found = camera_of(bag.decode(message), where := f"{bag.path}: {self.topic}")
        if found is None:
            return
        if self._found is None:
            self._found, self._content = found, content
        elif found != self._found:
            raise InputError(
                f"{where} at {bag.stamp(message) / NS_PER_S:.3f}: found {_in_words(found.raw)}, before it "
                f"{_in_words(self._found.raw)}; expected intrinsics that do not change: cut the bag there, or give "
                "'intrinsics'"
            )

    def camera(self, rectified: bool) -> Camera | None:
        """Return the intrinsics of raw or of rectified images; None if no message is calibrated.

        Raises:
            InputError: images are rectified by a rotation of the camera's frame.
        """
        if self._found is None:
            return None
        return self._found.rectified(self.topic) if rectified else self._found.raw


def _in_words(camera: Camera) -> str:
    values = zip(camera.parameters, camera.intrinsics.tolist(), strict=True)
    return f"{camera.width} x {camera.height}, {', '.join(f'{name} {value:.6g}' for name, value in values)}"
