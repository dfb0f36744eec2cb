"""Safe reading of untrusted YAML files."""

from collections.abc import Sequence
from pathlib import Path

from calibration.base.errors import CalibrationError
from calibration.base.files import read_bytes

MAX_BYTES = 1024 * 1024
"""Size limit of a YAML file; parsing a larger one would take minutes."""


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
