"""Files through which a step hands its outputs and its summary to the runner, in GitHub's form."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from calibration.base.errors import InfrastructureError

OutputValue: TypeAlias = str | Path | bool | int | float | Sequence[object] | Mapping[str, object]
"""Booleans are written as true and false, lists and mappings as JSON on one line."""
MAX_SUMMARY_BYTES = 1024 * 1024
"""GitHub's limit of the summary of a step; a longer one is dropped completely."""

_OUTPUT_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")
_CUT_NOTE = b"\n\n*The summary was cut here: GitHub takes 1 MiB. Everything is in the log.*\n"


def append_outputs(path: Path | None, values: Mapping[str, OutputValue]) -> None:
    """Append outputs of the step to a file; check them only, if there is none.

    Raises:
        ValueError: GitHub rejects a name, or a number is not finite.
        InfrastructureError: the file cannot be written.
    """
    lines = "".join(_format_assignment(name, _output_text(value)) for name, value in values.items())
    if path is None:
        return
    try:
        with path.open("a", encoding="utf-8", errors="backslashreplace", newline="") as file:
            file.write(lines)
    except OSError as error:
        raise InfrastructureError(f"{path}: the step's outputs cannot be written: {error.strerror}") from error


def append_summary(path: Path | None, markdown: str) -> None:
    """Append Markdown to the step's summary, if there is a file for it; beyond the limit it is cut with a remark.

    Raises:
        InfrastructureError: the file cannot be written.
    """
    if path is None:
        return
    try:
        with path.open("ab") as file:
            text = (markdown.rstrip("\n") + "\n").encode("utf-8", "replace")
            file.write(_cut_to_bytes(text, MAX_SUMMARY_BYTES - file.tell()))
    except OSError as error:
        raise InfrastructureError(f"{path}: the step's summary cannot be written: {error.strerror}") from error


def _output_text(value: OutputValue) -> str:
    if isinstance(value, str | Path):
        return str(value)
    return json.dumps(value, allow_nan=False)


def _format_assignment(name: str, value: str) -> str:
    if not _OUTPUT_NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not the name of an output")
    if "\n" not in value and "\r" not in value:
        return f"{name}={value}\n"
    # A random end, which the value cannot contain: otherwise untrusted text could set another output.
    delimiter = f"end-{os.urandom(16).hex()}"
    return f"{name}<<{delimiter}\n{value}\n{delimiter}\n"


def _cut_to_bytes(text: bytes, room: int) -> bytes:
    """Cut a text at the end of a line, so that it fits with a note."""
    if len(text) <= room:
        return text
    if room < len(_CUT_NOTE):
        return b""
    kept = text[: room - len(_CUT_NOTE)]
    kept = kept[: kept.rfind(b"\n")] if b"\n" in kept else kept.decode("utf-8", "ignore").encode()
    return kept + _CUT_NOTE
