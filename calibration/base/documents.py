"""Untrusted documents: YAML, JSON and XML read in bounds, and environment variables in them."""

import io
import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn
from xml.etree.ElementTree import Element

from calibration.base.errors import CalibrationError, InputError
from calibration.base.files import read_bytes
from calibration.base.text import one_line, shorten

MAX_BYTES = 1024 * 1024
"""Size limit of a YAML file; parsing a larger one would take minutes."""
MAX_ELEMENT_DEPTH = 100
"""Limit of nested elements; the supported formats need ten."""


def read_yaml(path: Path | str, what: str) -> object:
    """Parse a YAML file; nothing in it is executed.

    Args:
        path: the file.
        what: description of the expected content for messages: "a pipeline configuration".

    Raises:
        InputError: the file does not exist, is too large, or is not YAML; the message names file and line.
    """
    path = Path(path)
    data = read_bytes(path, MAX_BYTES, what)
    from calibration.base.yaml_loading import parse_yaml  # slow to import

    return parse_yaml(data, path)


def line_of(path: Path | str, keys: Sequence[str], value: str | None = None) -> int | None:
    """Return the line number of a key in a YAML file, from 1; of its last existing parent if it is missing, or None.

    Args:
        path: a file that `read_yaml` reads.
        keys: path of keys from the top.
        value: a string below the key; if it is found, its line is returned.
    """
    from calibration.base.yaml_loading import line_in  # slow to import

    try:
        data = read_bytes(path, MAX_BYTES, "YAML")
    except CalibrationError:
        return None
    return line_in(data, keys, value)


class RepeatedKeyError(ValueError):
    """An object has a repeated key, of which one value would be lost."""


def parse_json(text: str | bytes, *, finite: bool = True) -> Any:
    """Parse JSON.

    Args:
        text: the whole document.
        finite: refuse NaN and Infinity, which are not valid JSON; otherwise they are parsed as numbers.

    Raises:
        ValueError: it is not valid JSON.
        RecursionError: it is nested too deeply.
    """
    return json.loads(
        text, object_pairs_hook=_object_without_repeats, parse_constant=_refuse_constant if finite else None
    )


def read_json(path: Path | str, limit: int, what: str) -> Any:
    """Parse a JSON file of finite numbers.

    Args:
        path: the file.
        limit: size limit, bytes.
        what: description of the expected content for messages: "a reference".

    Raises:
        InputError: the file does not exist, is too large, or is not JSON.
    """
    return parse_json_of(read_bytes(path, limit, what), path, what)


def parse_json_of(content: str | bytes, where: object, what: str) -> Any:
    """Parse JSON of finite numbers; an error begins with ``where``, and names what was expected.

    Raises:
        InputError: it is not valid JSON.
    """
    try:
        return parse_json(content)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: this is no JSON, {what} was expected: {error}") from None


def _object_without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        counts = Counter(key for key, _ in pairs)
        repeated = next(key for key, count in counts.items() if count > 1)
        raise RepeatedKeyError(f"the key {shorten(repr(repeated))} occurs twice")
    return found


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"found {text}, a finite number was expected")


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


def xml_elements(data: bytes, name: str) -> Iterator[tuple[str, Element]]:
    """Yield ``("start" | "end", element)`` in the order of the document; an element that ended may be cleared.

    Raises:
        InputError: it is not XML, declares entities, or is nested too deeply.
    """
    # Only readers of reports need it, and introspect-csv is installed without it.
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, iterparse

    depth = 0
    try:
        for event, element in iterparse(io.BytesIO(data), ("start", "end")):
            depth += 1 if event == "start" else -1
            if depth > MAX_ELEMENT_DEPTH:
                raise InputError(
                    f"{name}: its elements are nested more than {MAX_ELEMENT_DEPTH} deep, the limit of a report"
                )
            yield event, element
    except DefusedXmlException:
        raise InputError(f"{name}: the XML declares entities, which are not allowed, for safety") from None
    except (ParseError, ValueError, LookupError) as error:  # the last two: unknown encoding
        raise InputError(f"{name}: this is not valid XML: {shorten(one_line(str(error)), 200)}") from None
