"""The package: its public names, imported only on use, and its wheel, which needs no repository."""

import ast
import doctest
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import calibration
from calibration.__main__ import main
from tests.thorough import thorough

ROOT = Path(calibration.__file__).parents[1]
UV = Path(sys.executable).with_name("uv")
DEBIAN = "/usr/bin/python3"


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
    from calibration.base import InputError

    assert InputError is calibration.InputError is calibration.errors.InputError


def test_importing_it_imports_the_ground_floor_without_numpy() -> None:
    script = "import calibration, sys; print(*(x for x in sys.modules if x.startswith(('calibration.', 'numpy'))))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT, timeout=60
    )
    modules = done.stdout.split()
    assert "calibration.errors" in modules
    assert {module.split(".")[1] for module in modules} == {"base", "errors"}


def test_its_example_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    assert doctest.testmod(calibration) == (0, 3)


# The wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL, timeout=120)
    [built] = folder.iterdir()
    return built


def test_the_wheel_has_the_package_and_nothing_else(wheel: Path) -> None:
    files = {path.relative_to(ROOT) for path in (ROOT / "calibration").rglob("*") if path.is_file()}
    with zipfile.ZipFile(wheel) as archive:
        packed = {Path(name) for name in archive.namelist() if ".dist-info/" not in name}
    assert packed == {path for path in files if "__pycache__" not in path.parts}


@pytest.mark.parametrize("python", [sys.executable, thorough(DEBIAN)])
def test_the_wheel_alone_does_what_the_clone_does(
    wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, python: str
) -> None:
    """In a new environment with what it asks for, in a repository that has but a dataset."""
    new = tmp_path / "new"
    what = f"calibration-ci[calibrate] @ {wheel.as_uri()}"
    if python == DEBIAN:
        if subprocess.run([python, "-c", "import ensurepip, tomllib"], check=False, capture_output=True).returncode:
            pytest.skip(f"needs {DEBIAN} 3.11 or newer with venv (apt-get install python3-venv)")
        made = [[python, "-m", "venv", new], [new / "bin" / "pip", "install", "--quiet", what]]
    else:
        locked = ("--constraint", ROOT / "requirements" / "engine.txt")
        made = [[UV, "venv", "--quiet", "--python", python, new]]
        made += [[UV, "pip", "install", "--quiet", "--python", new, *locked, what]]
    for command in made:
        subprocess.run(command, cwd=tmp_path, check=True, timeout=240)
    clone, alone = tmp_path / "clone", tmp_path / "alone"
    for repository in (clone, alone):
        shutil.copytree(ROOT / "datasets" / "t2rgb", repository / "data")
    monkeypatch.chdir(clone)
    for arguments in (["init", "--dataset", "data"], ["run"]):
        done = subprocess.run([new / "bin" / "calibration", *arguments], cwd=alone, check=False, timeout=120)
        assert done.returncode == main(arguments) == 0
    for name in ("calibration.yml", "output/data/translation-0_rotation-0_seed-1/rgb_to_rgb_results.csv"):
        assert (alone / name).read_text() == (clone / name).read_text()
