"""Log of a container: a file with secrets redacted and a size limit, and lines for live display."""

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

from calibration.base import shorten, writing
from calibration.base.redaction import Redactor
from calibration.ci.workflow.streams import tame

MOST_BYTES = 64 * 1024**2
"""Size limit of a log."""
LONGEST_LINE = 16 * 1024
"""Bytes; longer lines are processed in pieces."""


class LogFile:
    """Writes output to a log."""

    def __init__(
        self,
        path: Path,
        secrets: Iterable[str] = (),
        show: Callable[[str], None] | None = None,
        pattern: str | None = None,
        most_bytes: int = MOST_BYTES,
    ) -> None:
        """Create the file.

        Args:
            path: path of the file.
            secrets: strings to redact.
            show: receives every line.
            pattern: regular expression to search in every line.
            most_bytes: size limit; the file states if it was truncated.

        Raises:
            InfrastructureError: the file cannot be written.
        """
        self.path = path
        self.last_line = ""
        """Last non-empty line, safe for a message."""
        self.found = False
        """Whether a line has matched the pattern."""
        self._redactor = Redactor(secrets)
        self._show = show
        self._pattern = re.compile(pattern) if pattern else None
        self._most = most_bytes
        self._written = 0
        self._left_out = 0
        self._rest = b""
        with writing(path, "the log"):
            self._file = path.open("wb", buffering=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def feed(self, data: bytes) -> None:
        """Add output.

        Raises:
            InfrastructureError: the file cannot be written.
        """
        self._take_within_limit(self._redactor.feed(data))

    def close(self) -> None:
        """Finish the log; idempotent.

        Raises:
            InfrastructureError: the file cannot be written.
        """
        if self._file.closed:
            return
        try:
            self._take_within_limit(self._redactor.close())
            if self._rest:
                self._show_line(self._rest)
                self._rest = b""
            if self._left_out:
                self._write_bytes(f"\n(cut here: {self._left_out} more bytes were not kept)\n".encode())
        finally:
            self._file.close()

    def _take_within_limit(self, data: bytes) -> None:
        kept = data[: self._most - self._written]
        self._write_bytes(kept)
        self._written += len(kept)
        self._left_out += len(data) - len(kept)
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._show_line(line)
        while len(self._rest) > LONGEST_LINE:
            self._show_line(self._rest[:LONGEST_LINE])
            self._rest = self._rest[LONGEST_LINE:]

    def _show_line(self, data: bytes) -> None:
        text = data[:LONGEST_LINE].decode("utf-8", "replace")
        if self._show is not None:
            self._show(text)
        if self._pattern is not None and not self.found:
            self.found = self._pattern.search(text) is not None
        if line := tame(text).strip():
            self.last_line = shorten(line, 200)

    def _write_bytes(self, data: bytes) -> None:
        with writing(self.path, "the log"):
            if data:
                self._file.write(data)
