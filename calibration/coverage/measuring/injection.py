"""How the measurement gets into the Python of the tests: by variables, so that the team's command stays as it is."""

import os
from collections.abc import Mapping
from pathlib import Path

INJECTED = Path(__file__).with_name("injected")
REPORTER = INJECTED / "write_report.py"
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
    import coverage

    brought = folder / "brought"
    if not brought.is_dir():
        brought.mkdir()
        (brought / "coverage").symlink_to(Path(coverage.__file__).parent)
    return brought
