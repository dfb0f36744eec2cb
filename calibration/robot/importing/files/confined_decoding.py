"""Decoding of a file by a library in C or Rust, in a process that reads its folder only, and is killed if it stalls.

`confined_decoding` starts the process, which runs `main`: it confines itself, and its standard output is the only thing
that it can write.
"""

import io
import json
import math
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from struct import Struct
from typing import IO, Any, BinaryIO

import numpy as np

from calibration.base import InputError, one_line, shorten
from calibration.robot.confinement import limit_resources, restrict_by_kernel

MAX_STALLED_SECONDS = 60
"""s: limit of the time between two parts of what is decoded."""
CPU_SECONDS, BYTES_A_CPU_SECOND = 300, 100_000
"""Limit of the process's time of the processor: these seconds, and one for so many bytes of the file."""
MAX_ADDRESS_SPACE = 2 << 30
"""Bytes of address space of the process, of which it uses a part."""
FRAME_HEADER = Struct("<qddIIB")
"""Of a video's frame: index, time (ms), frames a second, width, height, and whether its pixels follow."""
_CHILD_CODE = (
    "import sys; sys.path.insert(0, sys.argv.pop(1)); "
    "from calibration.robot.importing.files.confined_decoding import main; main()"
)
_SOURCE_FOLDER = str(Path(__file__).resolve().parents[4])


class DecodedStream:
    """What the process writes, read as it comes."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream

    def read(self, size: int) -> bytes:
        """Read so many bytes, or fewer at the end.

        Raises:
            TimeoutError: nothing came for `MAX_STALLED_SECONDS` seconds.
        """
        parts: list[bytes] = []
        while size > 0:
            if not select.select([self._stream], [], [], MAX_STALLED_SECONDS)[0]:
                raise TimeoutError
            if not (part := os.read(self._stream.fileno(), min(size, 1 << 20))):
                break
            parts.append(part)
            size -= len(part)
        return b"".join(parts)


@contextmanager
def confined_decoding(kind: str, path: Path, what: str, **request: Any) -> Iterator[DecodedStream]:
    """Decode a file: the block reads what comes, and the process ends with it.

    Args:
        kind: of the decoders in `calibration.robot.importing.files.confined_decoding`.
        path: the file.
        what: it is, for messages: "a video".
        request: what the decoder needs besides.

    Raises:
        InputError: it cannot be decoded, takes too much memory or time, or stalls.
    """
    seconds = CPU_SECONDS + path.stat().st_size // BYTES_A_CPU_SECOND
    whole = {"kind": kind, "file": str(path.resolve()), "memory": MAX_ADDRESS_SPACE, "seconds": seconds, **request}
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(
            [sys.executable, "-I", "-c", _CHILD_CODE, _SOURCE_FOLDER, json.dumps(whole)],
            env={"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
        )
        if process.stdout is None:
            raise AssertionError("a pipe was asked for")
        try:
            yield DecodedStream(process.stdout)
            process.stdout.close()
            code = process.wait(MAX_STALLED_SECONDS)
        except (TimeoutError, subprocess.TimeoutExpired):
            raise InputError(
                f"{path}: {what} was expected, but decoding it stalls: nothing for {MAX_STALLED_SECONDS} s"
            ) from None
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
        if code == -signal.SIGXCPU:
            raise InputError(f"{path}: {what} was expected, but decoding it takes more than {seconds} s: cut it")
        if code not in (0, -signal.SIGPIPE):  # SIGPIPE, as enough was read
            log.seek(0)
            lines = log.read()[-10_000:].decode(errors="replace").strip().splitlines()
            why = (
                shorten(one_line(lines[-1]), 300)
                if code > 0 and lines
                else "decoding it fails, or needs too much memory"
            )
            raise InputError(f"{path}: {what} was expected: {why}")


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
    limit_resources(request["seconds"], request["memory"], LOG_BYTES)
    if sys.platform == "linux":
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
