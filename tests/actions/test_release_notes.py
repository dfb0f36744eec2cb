"""The notes of a release, and the tags that are refused."""

import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
SCRIPT = PROJECT / ".github" / "release_notes.py"
CHANGELOG = (
    "# Changelog\n\n## [Unreleased]\n\n## [1.2.3] - 2030-01-02\n\n### Added\n\n- A thing.\n\n## [1.2.2]\n\n- Old.\n"
)


@pytest.fixture
def notes(tmp_path: Path) -> Callable[..., str]:
    """Return the function under test, on a project of version 1.2.3 unless told."""
    function = runpy.run_path(str(SCRIPT))["notes"]

    def run(tag: str = "v1.2.3", package: str = "1.2.3", code: str = "1.2.3", changelog: str = CHANGELOG) -> str:
        (tmp_path / "calibration").mkdir(exist_ok=True)
        (tmp_path / "pyproject.toml").write_text(f'[project]\nversion = "{package}"\n')
        (tmp_path / "calibration" / "__init__.py").write_text(f'__version__ = "{code}"\n')
        (tmp_path / "CHANGELOG.md").write_text(changelog)
        return str(function(tag, tmp_path))

    return run


def test_the_section_of_the_version(notes: Callable[..., str]) -> None:
    assert notes() == "### Added\n\n- A thing."


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tag": "v1.2"}, "v1.2: a tag such as v1.2.3 was expected"),
        ({"tag": "v1.2.4"}, "pyproject.toml: found version 1.2.3, 1.2.4 was expected by the tag v1.2.4"),
        ({"code": "1.2.2"}, "calibration/__init__.py: found version 1.2.2, 1.2.3 was expected by the tag v1.2.3"),
        ({"changelog": "# Changelog\n"}, r"CHANGELOG.md: has no section \[1.2.3\] with text"),
        ({"changelog": "## [1.2.3]\n\n## [1.2.2]\n\n- Old.\n"}, r"has no section \[1.2.3\] with text"),
    ],
)
def test_what_does_not_fit_the_tag_is_refused(changes: dict[str, str], message: str, notes: Callable[..., str]) -> None:
    with pytest.raises(SystemExit, match=message):
        notes(**changes)


def test_this_project_has_one_version() -> None:
    done = subprocess.run(
        [sys.executable, "-I", str(SCRIPT), "v999.0.0"], capture_output=True, text=True, check=False, timeout=30
    )
    assert done.returncode == 1
    assert done.stderr.startswith("pyproject.toml: found version ")
