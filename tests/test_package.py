"""Public names of the package, imported only on use."""

import ast
import doctest
import subprocess
import sys
from pathlib import Path

import pytest

import calibration

ROOT = Path(calibration.__file__).parents[1]


def test_every_name_of_the_face_is_there() -> None:
    for name in calibration.__all__:
        assert getattr(calibration, name) is not None
    assert callable(calibration.calibrate)
    with pytest.raises(AttributeError, match="no attribute 'calibrat'"):
        calibration.calibrat  # noqa: B018


def test_type_checkers_see_the_same_names() -> None:
    tree = ast.parse(Path(calibration.__file__).read_text())
    typed = {alias.asname for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert typed - {None} == set(calibration.__all__) - {"__version__"}


def test_errors_have_their_public_path() -> None:
    from calibration.base.errors import InputError

    assert InputError is calibration.InputError is calibration.errors.InputError


def test_importing_it_imports_nothing_but_errors() -> None:
    script = "import calibration, sys; print(*(x for x in sys.modules if x.startswith(('calibration.', 'numpy'))))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT, timeout=60
    )
    assert done.stdout.split() == ["calibration.base", "calibration.base.errors", "calibration.errors"]


def test_its_example_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    assert doctest.testmod(calibration) == (0, 3)
