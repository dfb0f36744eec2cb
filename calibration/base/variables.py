"""Environment variables ``${NAME}`` in the user's documents."""

import math
import os
import re
from collections.abc import Mapping
from typing import Any

from calibration.base.errors import InputError

_VARIABLE_USE = r"\$\{([A-Za-z_][A-Za-z0-9_]*)\}"


def with_variables(value: object, where: str, environment: Mapping[str, str] | None = None) -> Any:
    """Return a document with ``${NAME}`` replaced in every string; other syntax is left unchanged.

    Args:
        value: content of a YAML file.
        where: file, and key in it, for messages.
        environment: variables; by default those of the process.

    Raises:
        InputError: a variable is not set, or a number is not finite; the message names the key.
    """
    variables = os.environ if environment is None else environment

    def variable(match: re.Match[str]) -> str:
        name = match[1]
        if name not in variables:
            raise InputError(f"{where}: the environment variable {name} is not set")
        return variables[name]

    if isinstance(value, str):
        return re.sub(_VARIABLE_USE, variable, value)
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{where}: found {value}, a finite number was expected")
    if isinstance(value, list):
        return [with_variables(item, f"{where}.{i}", variables) for i, item in enumerate(value)]
    if isinstance(value, dict):
        return {key: with_variables(item, f"{where}.{key}", variables) for key, item in value.items()}
    return value
