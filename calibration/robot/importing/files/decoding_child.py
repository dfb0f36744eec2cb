"""The process that decodes a file by a library in C or Rust: it confines itself, and writes what it decodes to a pipe.

`files.confined_decoding` starts it; its standard output is the only thing that it can write.
"""

import io
import json
import os
import resource
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from calibration.robot.expansion.child import restrict_by_kernel
from calibration.robot.importing.files.confined_decoding import FRAME_HEADER

LOG_BYTES = 1 << 20
"""Limit of what libraries print, which goes to a file."""
_CONTAINER_FORMATS = "mov,mp4,m4a,3gp,3g2,mj2,avi,matroska,webm"
_FFMPEG_OPTIONS = f"protocol_whitelist;file|format_whitelist;{_CONTAINER_FORMATS}"
"""Of FFmpeg: no playlist, which would name other files and hosts."""


def main() -> None:
    """Decode the file of the request, a JSON document in the arguments; the last line of stderr says why it cannot."""
    request = json.loads(sys.argv[1])
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is not what it decodes
    decode = _DECODER_OF_KIND[request["kind"]]()
    resource.setrlimit(resource.RLIMIT_FSIZE, (LOG_BYTES, LOG_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (request["seconds"], request["seconds"] + 1))
    if sys.platform == "linux":
        resource.setrlimit(resource.RLIMIT_AS, (request["memory"], request["memory"]))
        restrict_by_kernel([Path(request["file"]).parent])
    try:
        decode(request, output)
        output.flush()
    except BaseException as error:  # a panic of Rust is no Exception
        os.write(2, f"\n{' '.join(str(error).split()) or type(error).__name__}\n".encode(errors="replace"))
        os._exit(1)
    os._exit(0)  # nothing is left to write, and a library may hang where it ends


def _video_decoder() -> Callable[[Mapping[str, Any], BinaryIO], None]:
    """Return what writes the frames of a video: `FRAME_HEADER`, and the pixels (BGR) of those asked for."""
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = _FFMPEG_OPTIONS
    import cv2

    def write_frames(request: Mapping[str, Any], output: BinaryIO) -> None:
        capture = cv2.VideoCapture(request["file"], cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise ValueError("it is no mp4, avi or mkv, or its codec is not known")
        width, height = (int(capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if not 0 < width * height <= request["pixels"]:
            raise ValueError(f"found frames of {width} x {height} pixels, expected {request['pixels']} at most")
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # as images are read
        wanted, rate = frozenset(request["wanted"]), capture.get(cv2.CAP_PROP_FPS)
        for i in range(request["stop"]):
            if not capture.grab():
                return
            image = capture.retrieve()[1] if i in wanted else None
            if image is not None and image.shape != (height, width, 3):
                raise ValueError(f"frame {i} has the shape {image.shape}, expected ({height}, {width}, 3)")
            sent = int(image is not None)
            output.write(FRAME_HEADER.pack(i, capture.get(cv2.CAP_PROP_POS_MSEC), rate, width, height, sent))
            if image is not None:
                output.write(image.tobytes())

    return write_frames


def _laz_decoder() -> Callable[[Mapping[str, Any], BinaryIO], None]:
    """Return what writes the points (N, 3) of a LAZ file, as float64."""
    import laspy

    def write_points(request: Mapping[str, Any], output: BinaryIO) -> None:
        content = io.BytesIO(Path(request["file"]).read_bytes())
        with laspy.open(content, laz_backend=laspy.LazBackend.Lazrs) as reader:
            points = reader.read_points(request["points"])
        output.write(np.stack([np.asarray(points[axis], "<f8") for axis in "xyz"], -1).tobytes())

    return write_points


_DECODER_OF_KIND = {"video": _video_decoder, "laz": _laz_decoder}
