"""Data files of coverage.py (``.coverage``): the lines or arcs (jumps between lines) that were executed.

They do not contain the executable lines. Those are found by the Python that measured, from the sources: it
writes Cobertura XML.
"""

import os
import sqlite3
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from coverage import CoverageData
from coverage.exceptions import CoverageException

from calibration.addons.coverage.formats import MAX_BYTES, MAX_LINE, CoverageReport, parse_cobertura
from calibration.addons.coverage.injection import REPORTER_FILE, bring_coverage, reporting, write_settings
from calibration.base.errors import InfrastructureError, InputError
from calibration.base.files import read_bytes
from calibration.base.text import one_line, shorten

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
