"""Each add-on can be deleted as a folder: the rest imports, describes itself and calibrates without it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from calibration.base.addons import Addon, import_attribute, installed_addons

PROJECT = Path(__file__).parents[2]
PACKAGE = PROJECT / "calibration"
ADDONS = sorted(page.parent.name for page in (PACKAGE / "addons").glob("*/__init__.py"))
ALL = "all"
EVERY_MODULE = """
import importlib, pkgutil, calibration
for found in pkgutil.walk_packages(calibration.__path__, "calibration."):
    if not found.name.endswith("__main__"):
        importlib.import_module(found.name)
"""
EVERY_SCHEMA = """
from calibration.__main__ import main
from calibration.commands.schema import SHIPPED_SCHEMAS, generated
for name in SHIPPED_SCHEMAS:
    assert main(["schema", name]) == 0
    generated(name)
"""


def test_every_folder_is_found() -> None:
    assert len(ADDONS) == 9
    assert list(installed_addons()) == [import_attribute(f"calibration.addons.{name}:ADDON") for name in ADDONS]


class PackageWithout:
    """The package without an add-on, or without all, which takes the place of the installed one."""

    def __init__(self, name: str, folder: Path) -> None:
        self.deleted: dict[str, Addon] = {
            each: import_attribute(f"calibration.addons.{each}:ADDON") for each in ADDONS if name in (each, ALL)
        }
        self.folder = folder
        link_entries(PACKAGE, folder / "calibration", {"addons"})
        if name != ALL:
            link_entries(PACKAGE / "addons", folder / "calibration/addons", {name})

    def python(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run Python with this package, in its folder."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith(("GITHUB_", "INPUT_"))}
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=self.folder,
            env={**environment, "PYTHONPATH": str(self.folder)},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    def calibration(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run the command line of this package."""
        return self.python("-m", "calibration", *arguments)

    def run(self, text: str) -> subprocess.CompletedProcess[str]:
        """Run the pipeline of a calibration.yml with a system and more."""
        robot = f"systems: {{robot: {{dataset: '{PROJECT / 'datasets/t2rgb'}'}}}}\n"
        (self.folder / "calibration.yml").write_text(robot + text)
        return self.calibration("run", "--config", "calibration.yml", "--output", "output")


def link_entries(source: Path, target: Path, without: set[str]) -> None:
    """Make a folder with links to the entries of another, but some."""
    target.mkdir()
    for entry in source.iterdir():
        if entry.name not in without | {"__pycache__"}:
            (target / entry.name).symlink_to(entry)


@pytest.fixture(scope="module", params=[*ADDONS, ALL])
def package(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> PackageWithout:
    return PackageWithout(request.param, tmp_path_factory.mktemp(request.param))


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> PackageWithout:
    """The package without any add-on; that no add-on imports another one is tested in `tests.lint.test_floors`."""
    return PackageWithout(ALL, tmp_path_factory.mktemp("bare"))


def test_every_other_module_is_imported(bare: PackageWithout) -> None:
    done = bare.python("-c", EVERY_MODULE)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.thorough(but_first=2)
def test_its_commands_are_unknown_and_the_others_are_listed(package: PackageWithout) -> None:
    listed = package.calibration("--help")
    assert listed.returncode == 0, listed.stderr
    names = {line.split()[0] for line in listed.stdout.splitlines() if line.startswith("  ")}
    assert {"run", "calibrate-matrix", "version"} <= names
    for command in (name for addon in package.deleted.values() for name in addon.commands):
        assert command not in names
        done = package.calibration(command)
        assert done.returncode == 2
        assert f"there is no command '{command}'" in done.stderr


def test_every_other_schema_is_printed_and_generated(bare: PackageWithout) -> None:
    done = bare.python("-c", EVERY_SCHEMA)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_system_is_calibrated(bare: PackageWithout) -> None:
    done = bare.run("")
    assert done.returncode == 0, done.stdout + done.stderr
    results = json.loads((bare.folder / "output/results.json").read_text())
    assert (results["verdict"], len(results["cells"])) == ("pass", 1)


@pytest.mark.thorough(but_first=2)
def test_its_sections_and_backends_in_calibration_yml_are_input_errors_that_name_them(package: PackageWithout) -> None:
    for section in (name for addon in package.deleted.values() for name in addon.sections):
        done = package.run(f"{section}: {{}}\n")
        assert done.returncode == 2
        assert f"calibration.yml: unknown key '{section}'" in done.stderr
    for backend in (name for addon in package.deleted.values() for name in addon.backends):
        done = package.run(f"backend: {backend}\n")
        assert done.returncode == 2
        assert f"calibration.yml: backend: found '{backend}', expected docker" in done.stderr
