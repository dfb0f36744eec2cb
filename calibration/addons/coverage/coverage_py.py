"""coverage.py in the Python of the tests: injected by environment variables, with the team's settings; its data files.

Data files (``.coverage``) have the lines or arcs (jumps between lines) that were executed, not the executable lines.
Those are found by the Python that measured, from the sources: it writes Cobertura XML.
"""

import os
import re
import sqlite3
import subprocess
import warnings
from collections.abc import Mapping, Sequence
from contextlib import chdir, closing
from pathlib import Path
from typing import Any

import coverage
from coverage import CoverageData
from coverage.exceptions import ConfigError, CoverageException

from calibration import MAX_IMAGE_PIXELS
from calibration.addons.coverage.formats import MAX_BYTES, MAX_LINE, CoverageReport, parse_cobertura
from calibration.base import InfrastructureError, InputError, one_line, read_bytes, shorten

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


SQLITE_MAGIC = b"SQLite format 3\0"
XML_TIMEOUT = 300
"""Timeout for writing the XML."""


def measured_names(files: Sequence[Path]) -> list[str]:
    """Return the names of the measured files.

    Raises:
        InputError: one of the files is not a data file of coverage.py.
    """
    names: dict[str, None] = {}
    for file in files:
        with closing(_open_data(file)) as data:
            names.update(dict.fromkeys(sorted(data.measured_files())))
    return list(names)


def merge(files: Sequence[Path], names: Mapping[str, str], untouched: Sequence[str], folder: Path) -> list[Path]:
    """Merge the data of selected files into new data files: one of arcs, one of lines, each if there is any.

    Args:
        files: data files.
        names: absolute paths of the files to keep, by their names in the data.
        untouched: absolute paths of files of which no line was executed.
        folder: output folder.

    Raises:
        InputError: one of the files is not a data file of coverage.py.
    """
    with (
        closing(CoverageData(basename=str(folder / "jumps"))) as jumps,
        closing(CoverageData(basename=str(folder / "lines"))) as lines,
    ):
        for file in files:
            with closing(_open_data(file)) as data:
                for name in sorted(names.keys() & data.measured_files()):
                    path = names[name]
                    if data.has_arcs():
                        jumps.add_arcs({path: data.arcs(name) or []})
                    else:
                        lines.add_lines({path: data.lines(name) or []})
                    (jumps if data.has_arcs() else lines).touch_files([path], data.file_tracer(name) or None)
        if untouched:
            jumps.add_arcs({})
            jumps.touch_files(untouched)
    return [path for path in (folder / "jumps", folder / "lines") if path.exists()]


def report_of(data: Path, name: str, settings: Mapping[str, Any], directory: Path, executable: str) -> CoverageReport:
    """Convert a data file to a report that includes the executable lines.

    Args:
        data: data file with absolute file names.
        name: for messages.
        settings: settings of coverage.py.
        directory: folder that the names in the report are relative to.
        executable: the Python that measured; its temporary files are written beside the data.

    Raises:
        InfrastructureError: the report cannot be written.
    """
    configuration, output = data.with_suffix(".rc"), data.with_suffix(".xml")
    kept = {key: value for key, value in settings.items() if not key.startswith("run:") or key == "run:plugins"}
    write_settings(configuration, {"run:data_file": str(data), **kept})
    try:
        done = subprocess.run(
            [executable, str(REPORTER_FILE), str(configuration), str(data), str(output)],
            cwd=directory,
            env=reporting(os.environ, bring_coverage(data.parent)),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=XML_TIMEOUT,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InfrastructureError(f"{name}: {executable} cannot write a report of it: {one_line(str(error))}") from None
    if done.returncode:
        last_line = done.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2]
        raise InfrastructureError(f"{name}: coverage.py cannot report on it: {shorten(one_line(last_line), 300)}")
    report = parse_cobertura(read_bytes(output, MAX_BYTES, "coverage.py's report"), name)
    return CoverageReport(name, report.files, (str(directory),))


def _open_data(file: Path) -> CoverageData:
    """Open a data file after checking that it is valid SQLite."""
    refused = InputError(f"{file}: a data file of coverage.py was expected, and this one cannot be read")
    try:
        with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
            [(longest,)] = database.execute("SELECT coalesce(max(length(numbits)), 0) FROM line_bits")
            if not isinstance(longest, int) or longest * 8 > MAX_LINE + 8:
                raise InputError(f"{file}: it contains line numbers above {MAX_LINE}")
        data = CoverageData(basename=str(file))
        data.read()
        data.measured_files()
    except (sqlite3.Error, ValueError) as error:
        raise refused from error
    except CoverageException as error:
        raise InputError(f"{refused}: {shorten(one_line(str(error)), 200)}") from None
    return data


def copied(files: Sequence[Path], folder: Path) -> list[Path]:
    """Copy data files, because coverage.py opens them for writing.

    Raises:
        InputError: one of them is not a data file, or is too large.
    """
    copies = []
    for number, file in enumerate(files):
        content = read_bytes(file, MAX_BYTES, "a data file of coverage.py")
        copies.append(folder / f"{number}-{file.name.lstrip('.')}")
        copies[-1].write_bytes(content)
    return copies
