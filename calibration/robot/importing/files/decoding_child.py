"""The process that decodes a file by a library in C or Rust: it confines itself, and writes what it decodes to a pipe.

`files.confined_decoding` starts it; its standard output is the only thing that it can write.
"""

import io
import json
import math
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
SEEK_SECONDS = 1.0
"""s: from here on a frame is sought by its key frame; what is nearer is decoded on."""
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


def _sought_video_decoder() -> Callable[[Mapping[str, Any], BinaryIO], None]:
    """Return what writes the frames of a video that are shown at some times, sought from the key frames before them.

    In place of the frames a second stands the length of the video, s.
    """
    import av
    import av.subtitles.stream  # PyAV imports it when it opens a file, and this process reads no others then

    def write_frames(request: Mapping[str, Any], output: BinaryIO) -> None:
        with av.open(request["file"], options={"protocol_whitelist": "file"}) as container:
            if container.format.name.split(",")[0] not in _CONTAINER_FORMATS or not container.streams.video:
                raise ValueError("it is no mp4, avi or mkv with a video")
            stream = container.streams.video[0]
            if not 0 < stream.width * stream.height <= request["pixels"]:
                raise ValueError(f"found frames of {stream.width} x {stream.height} pixels")
            first, half = float((stream.start_time or 0) * stream.time_base), 0.5 / float(stream.average_rate or 30)
            frames, now = container.decode(stream), -math.inf
            seconds = (container.duration or 0) / av.time_base
            for i, time in enumerate(request["times"]):
                wanted = first + time - half
                if now >= wanted:
                    continue
                if wanted > now + SEEK_SECONDS:
                    container.seek(int(wanted / stream.time_base), stream=stream)
                    frames = container.decode(stream)
                found = next((each for each in frames if each.time is not None and each.time >= wanted), None)
                if found is None:
                    return
                image, now = found.to_ndarray(format="bgr24"), found.time
                height, width = image.shape[:2]
                output.write(FRAME_HEADER.pack(i, now - first, seconds, width, height, 1))
                output.write(image.tobytes())

    return write_frames


def _parquet_decoder() -> Callable[[Mapping[str, Any], BinaryIO], None]:
    """Return what writes columns of a file of parquet, as a JSON document of lists by name."""
    from pyarrow import parquet

    def write_columns(request: Mapping[str, Any], output: BinaryIO) -> None:
        file = parquet.ParquetFile(request["file"])
        names = file.schema_arrow.names
        if missing := [each for each in request["columns"] if each not in names]:
            raise ValueError(f"found no column '{missing[0]}', only {', '.join(names)}")
        if (rows := file.metadata.num_rows) > request["rows"]:
            raise ValueError(f"found {rows} rows, expected {request['rows']} at most")
        table = file.read(columns=request["columns"], use_threads=False).to_pydict()
        output.write(json.dumps(table, default=str).encode())

    return write_columns


def _laz_decoder() -> Callable[[Mapping[str, Any], BinaryIO], None]:
    """Return what writes the points (N, 3) of a LAZ file, as float64."""
    import laspy

    def write_points(request: Mapping[str, Any], output: BinaryIO) -> None:
        content = io.BytesIO(Path(request["file"]).read_bytes())
        with laspy.open(content, laz_backend=laspy.LazBackend.Lazrs) as reader:
            points = reader.read_points(request["points"])
        output.write(np.stack([np.asarray(points[axis], "<f8") for axis in "xyz"], -1).tobytes())

    return write_points


_DECODER_OF_KIND = {
    "video": _video_decoder,
    "sought-video": _sought_video_decoder,
    "parquet": _parquet_decoder,
    "laz": _laz_decoder,
}
