"""Decoding of a file by a library in C or Rust, in a process that reads its folder only, and is killed if it stalls."""

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from struct import Struct
from typing import IO, Any

from calibration.base import InputError, one_line, shorten

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
    "from calibration.robot.importing.files.decoding_child import main; main()"
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
        kind: of the decoders in `calibration.robot.importing.files.decoding_child`.
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
