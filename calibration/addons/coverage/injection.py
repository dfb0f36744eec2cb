"""Injection of coverage.py into the Python of the tests by environment variables, so that the command is unchanged."""

import os
import re
import warnings
from collections.abc import Mapping, Sequence
from contextlib import chdir
from pathlib import Path
from typing import Any

import coverage
from coverage.exceptions import ConfigError, CoverageException

from calibration import MAX_IMAGE_PIXELS
from calibration.base.errors import InputError
from calibration.base.text import one_line, shorten

INJECTED_FOLDER = Path(__file__).with_name("injected")
REPORTER_FILE = INJECTED_FOLDER / "calibration_coverage.py"
_HIDDEN_VARIABLES = (
    *("COVERAGE_PROCESS_START", "COVERAGE_PROCESS_CONFIG", "COVERAGE_FILE", "COVERAGE_RCFILE"),
    *("CODACY_PROJECT_TOKEN", "CODACY_API_TOKEN"),
)
"""Variables that are hidden from the tests: those of an outer measurement, and tokens."""
_OUR_LIMIT = ("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_IMAGE_PIXELS))


def plain(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment for a program of the team: without action inputs and tokens."""
    return {
        name: text
        for name, text in environment.items()
        if not name.startswith("INPUT_") and name not in _HIDDEN_VARIABLES and (name, text) != _OUR_LIMIT
    }


def measuring(environment: Mapping[str, str], configuration: Path, notes: Path, brought: Path) -> dict[str, str]:
    """Return the environment in which every Python process of the tests is measured.

    Args:
        environment: environment of this process.
        configuration: configuration file of coverage.py.
        notes: folder in which each Python process records the coverage.py that it uses.
        brought: result of :func:`bring_coverage`.
    """
    kept = plain(environment)
    path = os.pathsep.join(filter(None, [str(INJECTED_FOLDER), kept.get("PYTHONPATH")]))
    return {
        **kept,
        "PYTHONPATH": path,
        "PYTHONUNBUFFERED": "1",  # else the log would appear in one piece at the end
        "COVERAGE_PROCESS_START": str(configuration),
        "CALIBRATION_COVERAGE_NOTES": str(notes),
        "CALIBRATION_COVERAGE_BROUGHT": str(brought),
    }


def reporting(environment: Mapping[str, str], brought: Path) -> dict[str, str]:
    """Return the environment for :data:`REPORTER_FILE`."""
    return {**plain(environment), "CALIBRATION_COVERAGE_BROUGHT": str(brought)}


def bring_coverage(folder: Path) -> Path:
    """Create a folder that contains only our coverage.py, for a Python that has none."""
    brought = folder / "brought"
    if not brought.is_dir():
        brought.mkdir()
        (brought / "coverage").symlink_to(Path(coverage.__file__).parent)
    return brought


_KEPT_SETTINGS = (
    *("run:omit", "run:concurrency", "run:plugins", "run:patch", "run:sigterm", "run:core", "run:timid"),
    *("report:exclude_lines", "report:exclude_also", "report:partial_branches", "report:partial_also"),
)
"""Settings of the team that affect what counts and how the program has to be measured."""


def team_settings(directory: Path) -> dict[str, Any]:
    """Read the team's coverage.py settings from the files that coverage.py reads in a folder; unset ones are omitted.

    Raises:
        InputError: coverage.py rejects the file.
    """
    with chdir(directory), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings about settings of other versions
        try:
            team = coverage.Coverage(data_file=None)
        except (CoverageException, ValueError, OSError) as error:  # OSError: a file without read permission
            raise InputError(f"{directory}: coverage.py's settings: {shorten(one_line(str(error)), 300)}") from None
        settings = {name: _option_of_team(team, name) for name in _KEPT_SETTINGS}
        for plugin in settings["run:plugins"] or ():
            options = team.config.get_plugin_options(plugin)
            settings |= {f"{plugin}:{key}": value for key, value in options.items()}
        settings["run:omit"] = [_absolute_pattern(pattern) for pattern in settings["run:omit"] or ()]
    for name, more in (("exclude_lines", "exclude_also"), ("partial_branches", "partial_also")):
        known, also = settings[f"report:{name}"] or (), settings.pop(f"report:{more}") or ()
        settings[f"report:{name}"] = list(dict.fromkeys([*known, *also]))  # older versions lack the *_also settings
    return {name: value for name, value in settings.items() if value not in (None, False, [], "")}


def write_settings(path: Path, settings: Mapping[str, Any]) -> None:
    """Write settings as a file that every version of coverage.py reads."""
    sections: dict[str, list[str]] = {}
    for name, value in settings.items():
        section, _, key = name.rpartition(":")
        # A $ would start a variable, and a # or ; at the start of an expression a comment.
        values = [re.sub(r"^[#;]", r"[\g<0>]", str(item).replace("$", "$$")) for item in _as_sequence(value)]
        text = "\n    ".join(values)
        sections.setdefault(section, []).append(f"{key} = {text if len(values) == 1 else chr(10) + '    ' + text}")
    lines = [f"[{section}]\n" + "\n".join(keys) for section, keys in sections.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _as_sequence(value: object) -> Sequence[object]:
    return value if isinstance(value, list | tuple) else [value]


def _option_of_team(team: Any, name: str) -> Any:
    """Return a setting; None also if this version of coverage.py lacks it."""
    try:
        return team.get_option(name)
    except ConfigError:
        return None


def _absolute_pattern(pattern: str) -> str:
    """Make a pattern independent of the working directory, as coverage.py does."""
    return pattern if pattern.startswith(("*", "?")) else os.path.abspath(pattern)  # noqa: PTH100 (no .. left)
