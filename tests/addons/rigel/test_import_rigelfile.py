import os
import subprocess
import sys
from pathlib import Path

import pytest

from calibration.__main__ import main

PROJECT = Path(__file__).resolve().parents[3]
RIGELFILE = """
application: {distro: noetic}
jobs:
  build: {plugin: r.BuildXPlugin, with: {image: lab/robot, load: True}}
  calibrate:
    plugin: r.ComposePlugin
    with:
      components: [{name: c, image: lab/robot, command: calibrate, artifacts: [/t.csv], shm_size: 1g}]
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with a Rigelfile, outside of GitHub."""
    for name in [name for name in os.environ if name.startswith(("GITHUB_", "INPUT_", "RUNNER_"))]:
        monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Rigelfile").write_text(RIGELFILE)
    return tmp_path


def test_a_rigelfile_becomes_a_calibration_yml(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import-rigelfile"]) == 0
    out, err = capsys.readouterr()
    assert out == (
        "calibration.yml: 1 system, 0 simulations, an image; 4 to do, 0 work otherwise here, 1 not carried over\n"
    )
    where = "jobs.calibrate.with.components.c"
    assert f"warning: Rigelfile: not carried over: {where}.shm_size: there is no such setting" in err
    assert f"warning: Rigelfile: to do: {where}: dataset: name the folder of the dataset" in err
    text = (folder / "calibration.yml").read_text()
    assert text.startswith("# Made from Rigelfile by `calibration import-rigelfile`")
    assert "    dataset: TODO\n" in text


def test_errors_of_our_reader_are_reported(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("Rigelfile").write_text(
        RIGELFILE.replace("command: calibrate", "command: 'calibrate {{ vars.NOT_SET_HERE }}'")
    )
    assert main(["import-rigelfile", "--output", "sub/c.yml"]) == 0
    out, err = capsys.readouterr()
    last = out.splitlines()[-1]
    assert last.startswith(
        "before `calibration run --config sub/c.yml`: sub/c.yml: systems.calibrate.software.command.1"
    )
    assert last.endswith("the environment variable NOT_SET_HERE is not set")
    assert "to do: paths: they are relative to calibration.yml here: move it beside Rigelfile" in err


def test_an_existing_file_is_replaced_on_request_only(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "calibration.yml").write_text("mine")
    assert main(["import-rigelfile"]) == 2
    assert (
        "calibration.yml: there is such a file already: name another file, or add --overwrite"
        in capsys.readouterr().err
    )
    assert (folder / "calibration.yml").read_text() == "mine"
    assert main(["import-rigelfile", "--overwrite"]) == 0
    assert "systems:" in (folder / "calibration.yml").read_text()


def test_a_rigelfile_does_not_replace_itself(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["import-rigelfile", "--output", "Rigelfile", "--overwrite"]) == 2
    assert "Rigelfile: there is such a file already: name another file" in capsys.readouterr().err
    assert (folder / "Rigelfile").read_text() == RIGELFILE


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "Rigelfile: a Rigelfile was expected, but it cannot be read"),
        ("a: [", "Rigelfile:1: this is not valid YAML"),
        ("jobs: {}", "Rigelfile: nothing in it can be converted to calibration.yml: it has no jobs"),
        (
            "jobs: {a: {plugin: x.y}}",
            "nothing in it can be converted to calibration.yml: jobs.a: there is nothing like x.y here",
        ),
        ("jobs: 3", "Rigelfile: jobs: found 3, a mapping was expected"),
    ],
)
def test_bad_input(folder: Path, capsys: pytest.CaptureFixture[str], text: str | None, message: str) -> None:
    if text is None:
        (folder / "Rigelfile").unlink()
    else:
        (folder / "Rigelfile").write_text(text)
    assert main(["import-rigelfile"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert message in err
    assert err.count("\n") == 1
    assert not (folder / "calibration.yml").exists()


def test_nothing_of_the_engine_is_needed(folder: Path) -> None:
    """As after `pip install calibration-ci` without extras."""
    script = (
        "import sys; sys.modules['numpy'] = sys.modules['jsonschema'] = None\n"
        "from calibration.__main__ import main; sys.exit(main(['import-rigelfile']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
    )
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr
    assert (folder / "calibration.yml").exists()
