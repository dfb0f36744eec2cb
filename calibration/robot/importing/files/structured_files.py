"""Files of other tools as one kind of document: YAML, JSON, TOML, OpenCV's XML, ROS's INI, numpy's arrays and text."""

import io
import json
import re
import tomllib
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, ParseError

import defusedxml
import numpy as np
from defusedxml.ElementTree import fromstring

from calibration.base import InputError, RepeatedKeyError, parse_json, read_bytes
from calibration.base.documents import MAX_BYTES
from calibration.base.yaml_loading import parse_yaml
from calibration.engine.dataset.document import Node

MAX_XML_DEPTH = 50
"""Limit of elements inside of each other."""
_INI_NAMES = {"camera matrix": "camera_matrix", "distortion": "distortion_coefficients"}


def read_structured(path: Path, what: str) -> Node:
    """Read a file whose name tells its format (YAML if it tells none); nothing in it is executed.

    Args:
        path: of the file.
        what: description of the expected content for messages.

    Raises:
        InputError: the file cannot be read, or is not of the format that its name says.
    """
    data = read_bytes(path, MAX_BYTES, what)
    parse = (
        _parse_ini
        if re.search(rb"^\[image\]\s*$", data, re.MULTILINE)
        else PARSER_OF_ENDING.get(path.suffix.lower(), _parse_yaml_file)
    )
    try:
        return Node(path, (), parse(data, path))
    except RecursionError:
        raise InputError(f"{path}: nested too deeply") from None


def _parse_yaml_file(data: bytes, path: Path) -> Any:
    if data.startswith(b"%YAML"):  # OpenCV's first line is not valid in YAML 1.1 (``%YAML:1.0``)
        data = b"#" + data
    return parse_yaml(data, path)


def _parse_text_file(data: bytes, path: Path) -> Any:
    """Parse rows of numbers, as numpy.savetxt writes them, or else YAML."""
    lines = [line for line in data.decode("utf-8", "replace").splitlines() if line.strip() and line.lstrip()[0] != "#"]
    rows = [line.strip(" \t[],;").replace(",", " ").split() for line in lines]
    if not rows or not all(is_number(word) for row in rows for word in row):
        return _parse_yaml_file(data, path)
    return [[float(word) for word in row] for row in rows]


def _parse_json_file(data: bytes, path: Path) -> Any:
    try:
        return parse_json(data, finite=False)
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: line {error.lineno}, column {error.colno}: not JSON: {error.msg}") from None
    except (ValueError, RepeatedKeyError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read as JSON: {error}") from None


def _parse_toml(data: bytes, path: Path) -> Any:
    try:
        return tomllib.loads(data.decode())
    except ValueError as error:  # of TOML, of UTF-8, an integer of thousands of digits
        raise InputError(f"{path}: this is not valid TOML: {error}") from None


def _parse_xml(data: bytes, path: Path) -> Any:
    """Parse OpenCV's FileStorage, or any other XML of names and values."""
    try:
        return _value_of_element(fromstring(data), path, 0)
    except (ParseError, defusedxml.DefusedXmlException, ValueError) as error:
        raise InputError(f"{path}: this is not valid XML: {error}") from None


def _value_of_element(element: Element, path: Path, depth: int) -> Any:
    """Return a value, a list of values or of elements ``_``, or the elements by their names."""
    if depth > MAX_XML_DEPTH:
        raise InputError(f"{path}: found more than {MAX_XML_DEPTH} elements inside of each other, expected fewer")
    children = list(element)
    if not children:
        words = [_number_or_text(word) for word in (element.text or "").split()]
        is_text = any(isinstance(word, str) for word in words)
        return (element.text or "").strip() if is_text else words[0] if len(words) == 1 else words
    values = [_value_of_element(child, path, depth + 1) for child in children]
    if all(child.tag == "_" for child in children):
        return values
    return dict(zip((child.tag for child in children), values, strict=True))


def is_number(word: str) -> bool:
    """Whether a word is a number, as Python writes them."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def _number_or_text(word: str) -> float | str:
    return float(word) if is_number(word) else word


def _parse_ini(data: bytes, path: Path) -> Any:
    """Parse the INI file of ROS's camera_calibration: a name on a line, and the lines of its numbers."""
    found: dict[str, list[float]] = {}
    name = ""
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        words = line.split("#")[0].split()
        if not words or words[0].startswith("["):
            continue
        values = [_number_or_text(word) for word in words]
        if numbers := [value for value in values if isinstance(value, float)]:
            if len(numbers) < len(values) or not name:
                raise InputError(f"{path}:{number}: found '{line[:80]}', expected a name, or only numbers")
            found[name] += numbers
            continue
        name = _INI_NAMES.get(" ".join(words), " ".join(words))
        if name in found:
            raise InputError(f"{path}:{number}: found '{line[:80]}' again, expected one camera in a file")
        found[name] = []
    return {key: value[0] if len(value) == 1 else value for key, value in found.items()}


def _parse_arrays(data: bytes, path: Path) -> Any:
    """Parse numpy's arrays: one (.npy) or several by their names (.npz); never pickled objects."""
    try:
        if not zipfile.is_zipfile(io.BytesIO(data)):
            return np.load(io.BytesIO(data), allow_pickle=False).tolist()
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if (size := sum(each.file_size for each in archive.infolist())) > MAX_BYTES:
                raise InputError(f"{path}: found arrays of {size} bytes, expected {MAX_BYTES} at most")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return {name: arrays[name].tolist() for name in arrays.files}
    except InputError:
        raise
    except Exception as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: these are no arrays of numbers as numpy.save writes them: {said}") from None


PARSER_OF_ENDING: Mapping[str, Callable[[bytes, Path], Any]] = {
    ".json": _parse_json_file,
    ".txt": _parse_text_file,
    ".csv": _parse_text_file,
    ".toml": _parse_toml,
    ".xml": _parse_xml,
    ".npz": _parse_arrays,
    ".npy": _parse_arrays,
}
"""By the ending of a file's name."""
