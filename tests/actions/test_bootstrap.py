"""The way from a step of an action to its Python: run as a job runs it, without network."""

import json
import os
import shutil
import signal
import subprocess
import venv
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from calibration.base.addons import of_addons
from tests.docker_engine import wait_until
from tests.processes import group_runs, runs

from .conftest import PYTHON, Suite

SECTIONS_OF_ADDONS = {
    *of_addons(lambda addon: addon.sections),
    *(stage.section for stage in of_addons(lambda addon: addon.stages).values()),
}


def facts(result: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """Return what the command said of itself."""
    said: dict[str, Any] = json.loads(next(line for line in result.stdout.splitlines() if line.startswith("{")))
    return said


def test_the_command_runs_isolated_in_an_environment_of_its_own(suite: Suite) -> None:
    result = suite.run("introspect-csv", STATUS="1")
    assert result.returncode == 1
    [environment] = suite.environments
    assert environment.name.startswith("introspect-")
    assert (
        facts(result).items()
        >= {
            "action": "introspect-csv",
            "prefix": str(environment),
            "tiny": "1.0",
            "isolated": 1,
        }.items()
    )
    assert "::group::Python environment" in result.stdout
    assert result.stdout.index("::endgroup::") < result.stdout.index("{")
    assert not (environment / "bin" / "pip").exists()


def skip_without_uv(suite: Suite) -> None:
    if not (suite.uv / "uv").exists():
        pytest.skip("needs uv")


def test_uv_installs_where_there_is_one(suite: Suite) -> None:
    skip_without_uv(suite)
    result = suite.run("introspect-csv")
    assert result.returncode == 0, result.stdout
    assert "+ tiny==1.0" in result.stdout
    assert facts(result)["prefix"] == str(suite.environments[0])


def test_pip_installs_where_uv_fails(suite: Suite, tmp_path: Path) -> None:
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "uv").symlink_to("/bin/false")
    result = suite.run("introspect-csv", PATH=f"{tmp_path / 'broken'}:{suite.path_without_uv}")
    assert result.returncode == 0, result.stdout
    assert facts(result)["tiny"] == "1.0"


MANY = {f"part{number}": "1.0" for number in range(8)}


@pytest.mark.thorough
@pytest.mark.parametrize("program", ['#!/bin/bash\necho brought >&2\nexec {uv} "$@"\n', "#!/bin/false\n", ""])
def test_pip_brings_uv_where_there_is_much_to_install(suite: Suite, program: str) -> None:
    """And installs it all itself where that uv fails, or cannot be brought."""
    skip_without_uv(suite)
    suite.lock("introspect.txt", tiny="1.0", **MANY)
    suite.lock("uv.txt", program.format(uv=f"'{suite.uv / 'uv'}'"), **({"uv": "1.0"} if program else {"absent": "1.0"}))
    if not program:
        (suite.wheels / "absent-1.0-py3-none-any.whl").unlink()
    del suite.variables["PIP_NO_INDEX"]
    nowhere = f"file://{suite.wheels}/nowhere"
    result = suite.run("introspect-csv", PATH=suite.path_without_uv, PIP_INDEX_URL=nowhere, PIP_RETRIES="0")
    assert result.returncode == 0, result.stdout
    assert facts(result)["tiny"] == "1.0"
    assert ("brought" in result.stdout) == ("brought" in program), result.stdout
    assert (f"Installed {len(MANY) + 1} packages" in result.stdout) == ("brought" in program)
    assert len(suite.environments) == 1


@pytest.mark.thorough
def test_pip_does_it_all_where_uv_does_not_know_a_setting(suite: Suite) -> None:
    suite.lock("introspect.txt", tiny="1.0", **MANY)
    suite.lock("uv.txt", "#!/bin/false\n", uv="1.0")
    result = suite.run("introspect-csv", PATH=suite.path_without_uv)  # PIP_NO_INDEX
    assert result.returncode == 0, result.stdout
    assert "uv-1.0" not in result.stdout


def test_the_second_action_starts_at_once(suite: Suite) -> None:
    first = facts(suite.run("introspect-csv"))
    shutil.rmtree(suite.wheels)  # nothing can be installed any more
    second = suite.run("introspect-csv")
    assert facts(second)["prefix"] == first["prefix"]
    assert "installing" not in second.stdout


def test_a_larger_environment_serves_the_smaller_action(suite: Suite) -> None:
    first = facts(suite.run("calibrate-matrix", INPUT_IMAGE="robot:1"))
    assert facts(suite.run("introspect-csv"))["prefix"] == first["prefix"]
    assert len(suite.environments) == 1


def test_another_lock_makes_another_environment(suite: Suite) -> None:
    first = facts(suite.run("introspect-csv"))
    suite.lock("introspect.txt", tiny="1.1")
    second = facts(suite.run("introspect-csv"))
    assert (first["tiny"], second["tiny"]) == ("1.0", "1.1")
    assert len(suite.environments) == 2


def test_a_broken_environment_is_replaced(suite: Suite) -> None:
    environment = Path(facts(suite.run("introspect-csv"))["prefix"])
    (environment / "bin" / "python").unlink()
    assert facts(suite.run("introspect-csv"))["prefix"] == str(environment)
    assert suite.environments == [environment]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_an_interrupted_installation_leaves_nothing(suite: Suite, tmp_path: Path, number: signal.Signals) -> None:
    slow = tmp_path / "slow"
    slow.mkdir()
    (slow / "uv").write_text(f"#!/bin/bash\necho $$ >'{tmp_path}/started'\nsleep 60 & wait\n")
    (slow / "uv").chmod(0o755)
    with suite.start("introspect-csv", PATH=f"{slow}:{suite.variables['PATH']}") as process:
        started = tmp_path / "started"
        wait_until(lambda: started.exists() and started.read_text().endswith("\n"), "it installs")
        process.send_signal(number)
        assert process.wait(60) == (143 if number == signal.SIGTERM else -number)
    assert (suite.environments == []) is (number == signal.SIGTERM)  # the other cannot tidy up: the next one does
    still = group_runs if number == signal.SIGTERM else runs
    wait_until(lambda: not still(int(started.read_text())), "the installer has ended")
    assert suite.run("introspect-csv").returncode == 0
    assert [path.name[0] for path in suite.environments] == ["i"]


def test_what_another_one_is_making_is_left_alone(suite: Suite, bootstrap: ModuleType, tmp_path: Path) -> None:
    with bootstrap.scratch_folder(tmp_path) as first:
        with bootstrap.scratch_folder(tmp_path) as second:
            assert first != second
            assert first.is_dir()
        assert list(tmp_path.glob(".*")) == [first]


def test_two_at_once_share_what_the_first_has_made(suite: Suite) -> None:
    with suite.start("introspect-csv") as one, suite.start("introspect-csv") as two:
        outputs = [process.communicate(timeout=240)[0] for process in (one, two)]
    assert (one.returncode, two.returncode) == (0, 0), outputs
    [environment] = suite.environments
    assert all(str(environment) in output for output in outputs)


def test_signals_reach_the_command(suite: Suite) -> None:
    suite.run("introspect-csv")
    with suite.start("introspect-csv", SLEEP="60") as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("{"):
                assert json.loads(line)["pid"] == process.pid  # one process from the step's shell to the command
                break
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 42


def test_a_wrong_hash_ends_in_one_line(suite: Suite) -> None:
    lock = suite.folder / "requirements" / "introspect.txt"
    lock.write_text(lock.read_text().replace("sha256:", "sha256:00")[:-3] + "\n")
    result = suite.run("introspect-csv", PATH=suite.path_without_uv)
    assert result.returncode == 3
    assert result.stdout.splitlines()[-1].startswith("::error::the Python packages could not be installed with ")
    assert "Traceback" not in result.stdout
    assert suite.environments == []


HOSTILE = {
    "PIP_TARGET": "elsewhere",
    "PIP_USER": "1",
    "PIP_NO_BINARY": ":all:",
    "PIP_REQUIRE_VIRTUALENV": "1",
    "PIP_CONSTRAINT": "constraints.txt",
    "PIP_DRY_RUN": "1",
    "UV_NO_BINARY": "1",
    "UV_CONSTRAINT": "constraints.txt",
    "UV_SYSTEM_PYTHON": "1",
    "UV_TARGET": "elsewhere",
    "PYTHONPATH": ".",
    "PYTHONHOME": "nowhere",
    "PYTHONSAFEPATH": "",
    "VIRTUAL_ENV": "nowhere",
    "CONDA_PREFIX": "nowhere",
}


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("installer", ["pip", "uv"])
def test_settings_of_the_job_do_not_break_the_installation(suite: Suite, installer: str, tmp_path: Path) -> None:
    path = suite.path_without_uv
    if installer == "uv":
        skip_without_uv(suite)
        path = suite.variables["PATH"]
    folder = tmp_path / "workspace"
    folder.mkdir()
    (folder / "constraints.txt").write_text("tiny==9.9\n")
    (folder / "uv.toml").write_text("no-binary = true\n[pip]\ntarget = 'elsewhere'\n")
    (tmp_path / ".config" / "pip").mkdir(parents=True)
    (tmp_path / ".config" / "pip" / "pip.conf").write_text("[install]\ntarget = elsewhere\nno-deps = true\n")
    result = suite.run("introspect-csv", cwd=folder, **HOSTILE, PATH=path)
    assert result.returncode == 0, result.stdout
    assert facts(result)["tiny"] == "1.0"
    assert not (folder / "elsewhere").exists()
    assert "did not succeed" not in result.stdout


@pytest.mark.thorough
def test_a_mirror_in_pips_configuration_is_used(suite: Suite, tmp_path: Path) -> None:
    (tmp_path / "pip.conf").write_text(
        f"[global]\nno-index = true\nfind-links = {suite.variables.pop('PIP_FIND_LINKS')}\n"
    )
    suite.variables["PIP_CONFIG_FILE"] = str(tmp_path / "pip.conf")
    del suite.variables["PIP_NO_INDEX"]
    result = suite.run("introspect-csv", PATH=suite.path_without_uv)
    assert result.returncode == 0, result.stdout


def test_files_of_the_workspace_shadow_nothing(suite: Suite, tmp_path: Path) -> None:
    for name in ("yaml.py", "tiny.py", "json.py", "pathlib.py", "calibration.py", "sitecustomize.py", "pip.py"):
        (tmp_path / name).write_text("raise SystemExit('shadowed')\n")
    result = suite.run("introspect-csv", cwd=tmp_path, PYTHONPATH=str(tmp_path), PATH=suite.path_without_uv)
    assert result.returncode == 0, result.stdout
    assert facts(result)["tiny"] == "1.0"


def test_outside_github_the_environment_is_in_the_cache(suite: Suite, tmp_path: Path) -> None:
    del suite.variables["RUNNER_TEMP"], suite.variables["GITHUB_ACTIONS"]
    result = suite.run("introspect-csv")
    assert Path(facts(result)["prefix"]).parent == tmp_path / ".cache" / "calibration-ci"
    assert "::" not in result.stdout


def test_a_folder_that_cannot_be_written_is_named(suite: Suite, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = suite.run("introspect-csv", RUNNER_TEMP=str(tmp_path / "file"))
    assert result.returncode == 3
    assert result.stdout.startswith(f"::error::{tmp_path / 'file'}")


def test_what_the_system_refuses_is_told_in_one_line(suite: Suite) -> None:
    (suite.folder / "requirements" / "introspect.txt").unlink()
    result = suite.run("introspect-csv")
    assert result.returncode == 3
    [line] = result.stdout.splitlines()
    assert line.startswith("::error::the Python environment could not be made: ")


# A Python without pip


@pytest.fixture
def bare(suite: Suite, tmp_path: Path, bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make bootstrap.py find neither pip nor uv; return the Python of a venv to install into."""
    venv.create(tmp_path / "bare", symlinks=True)
    venv.create(tmp_path / "venv", symlinks=True)
    monkeypatch.setattr(bootstrap, "BASE_PYTHON", str(tmp_path / "bare" / "bin" / "python"))
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(suite.wheels))
    return tmp_path / "venv" / "bin" / "python"


@pytest.mark.thorough
def test_a_python_without_pip_borrows_the_one_of_ensurepip(suite: Suite, bare: Path, bootstrap: ModuleType) -> None:
    bootstrap.install(bare, ["-r", str(suite.folder / "requirements" / "introspect.txt")])
    assert packages(bare.parents[1]) == {"tiny"}


def test_a_python_without_ensurepip_says_what_to_install(
    bare: Path, bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bootstrap.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(bootstrap.BootstrapError, match="apt-get install python3-venv"):
        bootstrap.install(bare, ["tiny"])


# An interpreter of the user's own


@pytest.fixture
def own(suite: Suite, tmp_path: Path) -> Path:
    """Return a folder with an interpreter that has all that introspect-csv asks for."""
    folder = tmp_path / "own python"
    venv.create(folder, symlinks=True)
    [packages] = folder.glob("lib/python*/site-packages")
    for module in ("click", "yaml"):
        (packages / f"{module}.py").write_text("")
    (packages / "tiny.py").write_text("VERSION = 'own'")
    return folder


def test_nothing_is_installed_beside_ones_own_interpreter(suite: Suite, own: Path) -> None:
    result = suite.run("introspect-csv", INPUT_PYTHON=str(own / "bin" / "python"))
    assert facts(result).items() >= {"tiny": "own", "prefix": str(own), "isolated": 1}.items()
    assert suite.environments == []


def test_ones_own_interpreter_must_have_the_packages(suite: Suite, own: Path) -> None:
    result = suite.run("calibrate-matrix", INPUT_PYTHON=str(own / "bin" / "python"))
    assert result.returncode == 2
    [line] = result.stdout.splitlines()
    assert "cannot import numpy, defusedxml, rich: " in line


@pytest.mark.parametrize("value", ["3.12", "/nowhere/python", "--version", "$(touch pwned)", "x; touch pwned"])
def test_ones_own_interpreter_must_be_one(suite: Suite, value: str, tmp_path: Path) -> None:
    result = suite.run("introspect-csv", INPUT_PYTHON=value, cwd=tmp_path)
    assert result.returncode == 2
    [line] = result.stdout.splitlines()
    assert line.startswith("::error::input 'python'")
    assert not (tmp_path / "pwned").exists()


# Finding an interpreter


@pytest.fixture
def tools(tmp_path: Path) -> Path:
    """Return a folder for PATH with what bootstrap.sh itself needs, and a Python that is too old."""
    folder = tmp_path / "tools"
    folder.mkdir()
    for name in ("bash", "dirname"):
        found = shutil.which(name)
        assert found is not None
        (folder / name).symlink_to(found)
    (folder / "python3").symlink_to("/bin/false")
    return folder


def test_a_machine_without_python_is_told_in_one_line(suite: Suite, tools: Path) -> None:
    result = suite.run("introspect-csv", PATH=str(tools))
    assert result.returncode == 3
    [line] = result.stdout.splitlines()
    assert line.startswith("::error::no Python >= 3.11 on this machine")
    assert "uv python install 3.11" in line


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("place", ["tools/python3.12", "cache/Python/3.12.7/x64/bin/python3", "brought/by-uv"])
def test_a_newer_python_is_found(suite: Suite, tools: Path, tmp_path: Path, place: str) -> None:
    if place == "brought/by-uv":
        (tools / "uv").write_text(f"#!{tools}/bash\n[[ $1 == python ]] && echo '{tmp_path / place}'\n")
        (tools / "uv").chmod(0o755)
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / place).write_text(f"#!{tools}/bash\nexec '{PYTHON}' \"$@\"\n")
    (tmp_path / place).chmod(0o755)
    path = f"{tools}{os.pathsep}{suite.uv}"
    result = suite.run("introspect-csv", PATH=path, RUNNER_TOOL_CACHE=str(tmp_path / "cache"))
    assert result.returncode == 0, result.stdout


# The environment of the Makefile


def packages(folder: Path) -> set[str]:
    return {path.name.removesuffix(".py") for path in folder.glob("lib/python*/site-packages/*.py")}


def test_the_makefiles_environment_grows_and_is_never_downgraded(suite: Suite, tmp_path: Path) -> None:
    folder = tmp_path / ".venv"
    for lock, expected in (
        ("introspect.txt", {"tiny"}),
        ("calibrate.txt", {"tiny", "larger"}),
        ("introspect.txt", {"tiny", "larger"}),
    ):
        assert suite.run("environment", str(folder), lock).returncode == 0
        assert packages(folder) == expected
    assert suite.run("environment", str(folder), "calibrate.txt").stdout == ""  # there already


def test_the_makefiles_environment_takes_one_line_in_a_terminal(suite: Suite, tmp_path: Path) -> None:
    del suite.variables["GITHUB_ACTIONS"]
    result = suite.run("environment", str(tmp_path / ".venv"), "introspect.txt")
    assert result.stdout == "setting up .venv with requirements/introspect.txt (once)\n"


@pytest.mark.thorough
def test_a_terminal_shows_what_the_installers_print_if_all_fail(suite: Suite, tmp_path: Path) -> None:
    del suite.variables["GITHUB_ACTIONS"]
    suite.lock("introspect.txt", tiny="1.0", absent="1.0")
    (suite.wheels / "absent-1.0-py3-none-any.whl").unlink()
    result = suite.run("environment", str(tmp_path / ".venv"), "introspect.txt")
    first, *printed, last = result.stdout.splitlines()
    assert result.returncode == 3
    assert first.startswith("setting up .venv")
    assert any("absent==1.0" in line for line in printed)
    assert last.startswith("the Python packages could not be installed with ")


def test_the_makefiles_environment_follows_the_lock(suite: Suite, tmp_path: Path) -> None:
    folder = tmp_path / ".venv"
    suite.run("environment", str(folder), "introspect.txt")
    suite.lock("introspect.txt", tiny="1.1")
    suite.run("environment", str(folder), "introspect.txt")
    [module] = folder.glob("lib/python*/site-packages/tiny.py")
    assert "1.1" in module.read_text()


def test_the_makefiles_environment_follows_the_interpreter(suite: Suite, tmp_path: Path) -> None:
    folder = tmp_path / ".venv"
    suite.run("environment", str(folder), "introspect.txt")
    marker = folder / "calibration-ci.txt"
    marker.write_text("another Python\ntiny==1.0")
    (folder / "old").write_text("")
    assert suite.run("environment", str(folder), "introspect.txt").returncode == 0
    assert not (folder / "old").exists()
    assert packages(folder) == {"tiny"}


def test_a_venv_made_by_hand_is_filled_with_its_own_python(suite: Suite, own: Path) -> None:
    assert suite.run("environment", str(own), "calibrate.txt").returncode == 0
    assert packages(own) == {"click", "yaml", "tiny", "larger"}


@pytest.mark.parametrize("arguments", [[], ["unknown"], ["environment", "x"]])
def test_wrong_arguments_are_bad_input(suite: Suite, arguments: list[str]) -> None:
    result = suite.run(*arguments)
    assert result.returncode == 2
    assert "usage" in result.stdout


def test_too_old_a_python_is_told_in_one_line(suite: Suite) -> None:
    path = suite.folder / "actions" / "bootstrap.py"
    code = f"import runpy, sys; sys.version_info = (3, 8, 18); runpy.run_path({str(path)!r})"
    result = subprocess.run([PYTHON, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 3
    assert "Calibration CI needs Python 3.11 or newer" in result.stdout
    assert "uv venv --python 3.11" in result.stdout


@pytest.mark.parametrize(
    ("config", "only_engine"),
    [
        ("systems: {robot: {dataset: data/robot, limits: {rms-px: 1}}}\nbaseline: {required: true}\n", True),
        ("systems: {robot: {dataset: 'simulation:fresh'}}\n", False),
        ("systems: {robot: {dataset: data, software: {command: [calibrate]}}}\n", False),
        ("systems: {robot: {exports: {robot-description: robot.urdf.xacro}}}\n", False),
        *((f"systems: {{}}\n{section}: {{}}\n", False) for section in sorted(SECTIONS_OF_ADDONS)),
        ("#" * (1 << 20) + "\n", False),
    ],
)
def test_the_root_action_installs_the_engine_alone_where_that_is_all(
    bootstrap: ModuleType, tmp_path: Path, config: str, only_engine: bool
) -> None:
    (tmp_path / "calibration.yml").write_text(config)
    assert bootstrap.only_calibrates(tmp_path / "calibration.yml") is only_engine


@pytest.mark.parametrize(
    ("given", "enough"),
    [
        ({"INPUT_DATASET": "data/robot", "INPUT_CONFIG": ""}, True),
        ({"INPUT_DATASET": "data/robot", "INPUT_IMAGE": "robot:1"}, False),
        ({"INPUT_CONFIG": "containers.yml"}, False),
        ({"INPUT_CONFIG": "containers.yml", "CELL_IMAGE": ""}, True),
        ({"INPUT_DATASET": "data/robot", "CELL_IMAGE": "given"}, False),
    ],
)
def test_a_matrix_without_containers_takes_the_engine_alone(
    bootstrap: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: dict[str, str], enough: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("containers.yml").write_text("systems: {robot: {dataset: data, software: {command: [calibrate]}}}\n")
    assert bootstrap.engine_is_enough(given) is enough
