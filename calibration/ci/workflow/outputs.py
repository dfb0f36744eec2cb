"""Outputs of the step, for later steps of the job."""

import json
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from calibration.base.errors import InfrastructureError
from calibration.ci.workflow.runner import Runner

OutputValue: TypeAlias = str | Path | bool | int | float | Sequence[object] | Mapping[str, object]
"""Booleans are written as true and false, lists and mappings as JSON on one line."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def set_outputs(runner: Runner, values: Mapping[str, OutputValue]) -> None:
    """Set outputs of the step; does nothing if the runner provides no file for them.

    Raises ``ValueError`` for a name that GitHub rejects or a number that is not finite, and
    :class:`InfrastructureError` if the runner's file cannot be written.
    """
    lines = "".join(_assignment(name, _text(value)) for name, value in values.items())
    if runner.output_file is None:
        return
    try:
        with runner.output_file.open("a", encoding="utf-8", errors="backslashreplace", newline="") as file:
            file.write(lines)
    except OSError as error:
        raise InfrastructureError(
            f"{runner.output_file}: the step's outputs cannot be written: {error.strerror}"
        ) from error


def _text(value: OutputValue) -> str:
    if isinstance(value, str | Path):
        return str(value)
    return json.dumps(value, allow_nan=False)


def _assignment(name: str, value: str) -> str:
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not the name of an output")
    if "\n" not in value and "\r" not in value:
        return f"{name}={value}\n"
    delimiter = f"end-{os.urandom(16).hex()}"
    return f"{name}<<{delimiter}\n{value}\n{delimiter}\n"
