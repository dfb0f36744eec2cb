"""Some frames of a video, sought by their times: a file of many episodes is never decoded whole."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.base import InputError
from calibration.base.optional import optional
from calibration.robot.importing.files.confined_decoding import FRAME_HEADER, confined_decoding
from calibration.robot.importing.videos import MAX_FRAME_PIXELS
from calibration.robot.labelling.detection import Image, grey


@dataclass(frozen=True)
class SoughtFrame:
    """Frame of a video."""

    time: float
    """s, in the video."""
    seconds: float
    """Length of the video."""
    image: Image
    """(H, W), grey."""


def frames_at(path: Path, times: Sequence[float]) -> Iterator[SoughtFrame]:
    """Yield the frames that are shown at some times, s, rising.

    Raises:
        InputError: it is no video, or damaged.
        InfrastructureError: PyAV is not installed.
    """
    optional("av", "episodes of videos")
    if not path.is_file():
        raise InputError(f"{path}: found no such file, expected a video of the dataset")
    request = {"times": list(times), "pixels": MAX_FRAME_PIXELS}
    with confined_decoding("sought-video", path, "a video", **request) as decoded:
        while len(head := decoded.read(FRAME_HEADER.size)) == FRAME_HEADER.size:
            _, time, seconds, width, height, _ = FRAME_HEADER.unpack(head)
            if not 0 < width * height <= MAX_FRAME_PIXELS:
                raise InputError(f"{path}: found frames of {width} x {height} pixels")
            data = decoded.read(3 * width * height)
            if len(data) < 3 * width * height:
                return
            yield SoughtFrame(time, seconds, grey(np.frombuffer(data, np.uint8).reshape(height, width, 3)))
