"""How coverage.py gets into the Python of the tests: by variables and settings, so that the command stays as it is."""

import os
import re
import warnings
from collections.abc import Mapping, Sequence
from contextlib import chdir
from pathlib import Path
from typing import Any

import coverage
from coverage.exceptions import ConfigError, CoverageException

from calibration.errors import InputError
from calibration.workflow.text import one_line, shorten

INJECTED = Path(__file__).with_name("injected")
REPORTER = INJECTED / "calibration_coverage.py"
_HIDDEN = (
    *("COVERAGE_PROCESS_START", "COVERAGE_PROCESS_CONFIG", "COVERAGE_FILE", "COVERAGE_RCFILE"),
    *("CODACY_PROJECT_TOKEN", "CODACY_API_TOKEN"),
)
"""Of a measurement that we may be part of ourselves; and what only we may know."""


def plain(environment: Mapping[str, str]) -> dict[str, str]:
    """The variables for a program of the team: without the inputs of the action, and without tokens."""
    return {name: text for name, text in environment.items() if not name.startswith("INPUT_") and name not in _HIDDEN}


def measuring(environment: Mapping[str, str], configuration: Path, notes: Path, brought: Path) -> dict[str, str]:
    """The variables that have every Python process of the tests measured.

    Args:
        environment: ours.
        configuration: of coverage.py.
        notes: a folder, in which each Python leaves a note of what it measures with.
        brought: of :func:`bring_coverage`.
    """
    kept = plain(environment)
    path = os.pathsep.join(filter(None, [str(INJECTED), kept.get("PYTHONPATH")]))
    return {
        **kept,
        "PYTHONPATH": path,
        "PYTHONUNBUFFERED": "1",  # or the log would come in one piece at the end
        "COVERAGE_PROCESS_START": str(configuration),
        "CALIBRATION_COVERAGE_NOTES": str(notes),
        "CALIBRATION_COVERAGE_BROUGHT": str(brought),
    }


def reporting(environment: Mapping[str, str], brought: Path) -> dict[str, str]:
    """The variables for :data:`REPORTER`."""
    return {**plain(environment), "CALIBRATION_COVERAGE_BROUGHT": str(brought)}


def bring_coverage(folder: Path) -> Path:
    """Make a folder with our coverage.py alone, for a Python that has none: none of our other packages gets in."""
    brought = folder / "brought"
    if not brought.is_dir():
        brought.mkdir()
        (brought / "coverage").symlink_to(Path(coverage.__file__).parent)
    return brought


_KEPT = (
    *("run:omit", "run:concurrency", "run:plugins", "run:patch", "run:sigterm", "run:core", "run:timid"),
    *("report:exclude_lines", "report:exclude_also", "report:partial_branches", "report:partial_also"),
)
"""The team's settings that say what counts, and how their program has to be measured."""


def team_settings(directory: Path) -> dict[str, Any]:
    """What the team has set for coverage.py, in whichever file it reads in that folder; without what is not set.

    Raises:
        InputError: coverage.py does not understand the file.
    """
    with chdir(directory), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of settings for other versions than ours
        try:
            team = coverage.Coverage(data_file=None)
        except (CoverageException, ValueError, OSError) as error:  # OSError: a file that may not be read
            raise InputError(f"{directory}: coverage.py's settings: {shorten(one_line(str(error)), 300)}") from None
        settings = {name: _option(team, name) for name in _KEPT}
        for plugin in settings["run:plugins"] or ():
            options = team.config.get_plugin_options(plugin)
            settings |= {f"{plugin}:{key}": value for key, value in options.items()}
        settings["run:omit"] = [_absolute(pattern) for pattern in settings["run:omit"] or ()]
    for name, more in (("exclude_lines", "exclude_also"), ("partial_branches", "partial_also")):
        known, also = settings[f"report:{name}"] or (), settings.pop(f"report:{more}") or ()
        settings[f"report:{name}"] = list(dict.fromkeys([*known, *also]))  # older versions know no other setting
    return {name: value for name, value in settings.items() if value not in (None, False, [], "")}


def write_settings(path: Path, settings: Mapping[str, Any]) -> None:
    """Write settings as a file that every version of coverage.py reads."""
    sections: dict[str, list[str]] = {}
    for name, value in settings.items():
        section, _, key = name.rpartition(":")
        # A $ would begin a variable, and a # or ; at the beginning of an expression a comment.
        values = [re.sub(r"^[#;]", r"[\g<0>]", str(item).replace("$", "$$")) for item in _items(value)]
        text = "\n    ".join(values)
        sections.setdefault(section, []).append(f"{key} = {text if len(values) == 1 else chr(10) + '    ' + text}")
    lines = [f"[{section}]\n" + "\n".join(keys) for section, keys in sections.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _items(value: object) -> Sequence[object]:
    return value if isinstance(value, list | tuple) else [value]


def _option(team: Any, name: str) -> Any:
    """A setting; None too where our version of coverage.py does not have it."""
    try:
        return team.get_option(name)
    except ConfigError:
        return None


def _absolute(pattern: str) -> str:
    """A pattern that means the same in every folder, as coverage.py understands it where it is written."""
    return pattern if pattern.startswith(("*", "?")) else os.path.abspath(pattern)  # noqa: PTH100 (no .. left)
