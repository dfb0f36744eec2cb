"""A line that is waited for in the output of a container, which another container writes to a file."""

import os
import re

from calibration.execution.batch.inside.signs import LOG, Signs
from calibration.execution.log_file import LONGEST_LINE, MOST_BYTES

_CHUNK = 1024**2


class LogLine:
    """Looks for a regular expression in every line, each of which is read once."""

    def __init__(self, signs: Signs, name: str, pattern: str, most_bytes: int = MOST_BYTES) -> None:
        """Begin; of the file no more is kept on the volume than ``most_bytes``."""
        self.found = False
        self._signs = signs
        self._name = name
        self._pattern = re.compile(pattern)
        self._most = most_bytes
        self._position = 0
        self._rest = b""

    def look(self) -> bool:
        """Read on for a while; whether the line is there, or was."""
        descriptor = self._signs.open(self._name, LOG)
        if descriptor is not None:
            try:
                self._look(descriptor)
            finally:
                os.close(descriptor)
        return self.found

    def _look(self, descriptor: int) -> None:
        if self.found:
            self._position = os.fstat(descriptor).st_size
        else:
            data = os.pread(descriptor, _CHUNK, self._position)
            self._position += len(data)
            *lines, rest = (self._rest + data).split(b"\n")
            self._rest = rest[-LONGEST_LINE:]
            self.found = any(self._matches(line) for line in [*lines, *([rest] if len(rest) > LONGEST_LINE else [])])
        if self._position > self._most:  # it has been read, and who writes appends
            self._cut()
            self._position = 0

    def _cut(self) -> None:
        descriptor = self._signs.open(self._name, LOG, os.O_WRONLY)
        if descriptor is not None:
            os.ftruncate(descriptor, 0)
            os.close(descriptor)

    def _matches(self, line: bytes) -> bool:
        return self._pattern.search(line[:LONGEST_LINE].decode("utf-8", "replace")) is not None
