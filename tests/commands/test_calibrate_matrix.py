"""Command ``calibrate-matrix``."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from calibration.__main__ import main, run_action
from tests.docker_engine import wait_until
from tests.processes import group_runs

ROOT = Path(__file__).parents[2]
T2RGB = str(ROOT / "datasets" / "t2rgb")
EVALUATE = "rgb-to-rgb:right_camera:left_camera"


def results(output: Path) -> dict:  # type: ignore[type-arg]
    found: dict = json.loads((output / "results.json").read_text())  # type: ignore[type-arg]
    return found


def test_a_dataset_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["calibrate-matrix", "--dataset", T2RGB, "--output", str(tmp_path)])

    assert code == 0
    (cell,) = results(tmp_path)["cells"]
    assert (cell["system"], cell["verdict"], cell["start"], cell["seed"]) == ("t2rgb", "pass", "linear", 1)
    assert cell["truth"]["translation_mm"] < 1
    assert "pass: 1 cell calibrated" in capsys.readouterr().out


def test_the_file_itself_and_the_whole_matrix(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--dataset", f"{T2RGB}/dataset.json", "--evaluate", EVALUATE, "--output", str(tmp_path)]
    noise = ["--translation-noise", "0,0.5", "--rotation-noise", "0\n0.5", "--seed-list", "3,7", "--loss", "linear"]

    assert main(["calibrate-matrix", *arguments, *noise]) == 0

    found = results(tmp_path)
    assert len(found["cells"]) == 8
    assert {cell["seed"] for cell in found["cells"]} == {3, 7}
    assert len({cell["rms_px"] for cell in found["cells"]}) == 1
    assert found["summary"]["success_rate"] == 1
    assert "2/2 pass" in capsys.readouterr().out


def test_intrinsics_and_fixed_parameters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "first"
    asked = ["--intrinsics", "left_camera", "--hold", "intrinsics-left_camera-k3,intrinsics-left_camera-k2"]
    assert main(["calibrate-matrix", "--dataset", T2RGB, *asked, "--output", str(output)]) == 0

    (cell,) = results(output)["cells"]
    known = output / Path(cell["dataset"]).with_name("intrinsics.json")
    left = json.loads(known.read_text())["cameras"]["left_camera"]
    assert left["parameters"] == ["fx", "fy", "cx", "cy", "k1", "p1", "p2"]
    assert abs(left["values"][0] - 554.256) < 0.5
    assert "| left\\_camera | fx |" in (output / "summary.md").read_text()

    again = ["--intrinsics", "all", "--intrinsics-covariance", str(known), "--output", str(tmp_path / "second")]
    assert main(["calibrate-matrix", "--dataset", T2RGB, *again]) == 0
    # an input inside the results folder must survive their replacement
    same = ["--intrinsics-covariance", str(known), "--output", str(output)]
    assert main(["calibrate-matrix", "--dataset", T2RGB, *same]) == 2
    assert known.exists()
    assert "choose another output" in capsys.readouterr().err


def test_a_start_that_does_not_come_back_is_red(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    noise = ["--translation-noise", "2", "--rotation-noise", "3", "--seeds", "12", "--start", "given"]

    code = main(["calibrate-matrix", "--dataset", T2RGB, *noise, "--output", str(tmp_path)])

    assert code == 1
    assert results(tmp_path)["verdict"] == "fail"
    assert "error: t2rgb, 2 m, 3 rad, seed" in capsys.readouterr().err


def test_why_there_is_no_result_is_in_the_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate-matrix", "--dataset", T2RGB, "--compare", "icp", "--output", str(tmp_path)]) == 0
    assert re.search(r"t2rgb, icp, .*: no result: .*ICP does not apply", capsys.readouterr().out)


def test_rules_from_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rules = tmp_path / "rules.yml"
    rules.write_text("rules: [{column: RMS (pix), row: Averages, max: 0.01}]")
    arguments = ["--dataset", T2RGB, "--evaluate", EVALUATE, "--rules", str(rules), "--output", str(tmp_path / "o")]

    assert main(["calibrate-matrix", *arguments]) == 1
    assert "RMS (pix), Averages" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "exactly one of dataset and config"),
        (["--dataset", T2RGB, "--config", "calibration.yml"], "exactly one of dataset and config"),
        (["--dataset", "/no/such"], "/no/such"),
        (["--dataset", T2RGB, "--translation-noise", "-1"], "translation-noise"),
        (["--dataset", T2RGB, "--translation-noise", "nan"], "translation-noise"),
        (["--dataset", T2RGB, "--seeds", "0"], "seeds"),
        (["--dataset", T2RGB, "--seeds", "2", "--seed-list", "1"], "exclude each other"),
        (["--dataset", T2RGB, "--start", "guess"], "start"),
        (["--dataset", T2RGB, "--systems", "riwbot"], "riwbot"),
        (["--dataset", T2RGB, "--evaluate", "rgb-to-rgb:a:b"], "no sensor 'a'"),
        (["--dataset", T2RGB, "--sart", "linear"], "--start"),
        (["--dataset", T2RGB, "--registry-username", "me"], "registry-password is not given"),
        (["--dataset", T2RGB, "--registry-password", "words"], "put it into the environment variable CALIBRATION_REG"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate-matrix", *arguments, "--output", str(tmp_path)]) == 2

    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_login_without_the_image_that_it_is_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CALIBRATION_REGISTRY_PASSWORD", "planted words")
    arguments = ["calibrate-matrix", "--dataset", T2RGB, "--output", str(tmp_path)]
    assert main(arguments) == 0  # the variable is for another command
    assert main([*arguments, "--registry-username", "me"]) == 2
    said = capsys.readouterr()
    assert "registry-username is given without the image that it is for" in said.err
    assert "planted words" not in said.out + said.err


def test_a_password_without_a_user_is_reported_in_an_action(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in {"DATASET": T2RGB, "IMAGE": "robot", "COMMAND": "x", "REGISTRY_PASSWORD": "words"}.items():
        monkeypatch.setenv(f"INPUT_{name}", value)
    assert run_action("calibrate-matrix") == 2
    assert "registry-username is not given: user and password go together" in capsys.readouterr().err


def test_an_output_folder_that_cannot_be_written_is_an_infrastructure_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")

    assert main(["calibrate-matrix", "--dataset", T2RGB, "--output", str(tmp_path / "file" / "output")]) == 3
    assert "is a file" in capsys.readouterr().err


def test_the_outputs_of_a_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GITHUB_OUTPUT", str(tmp_path / "outputs"))
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "summary"))
    output = tmp_path / "output"

    main(["calibrate-matrix", "--dataset", T2RGB, "--evaluate", EVALUATE, "--output", str(output)])

    outputs = dict(line.split("=", 1) for line in (tmp_path / "outputs").read_text().splitlines())
    assert outputs["verdict"] == "pass"
    assert outputs["results"] == str(output / "results.json")
    assert float(outputs["success-rate"]) == 1
    assert float(outputs["worst-rms-px"]) == results(output)["cells"][0]["rms_px"]
    assert "| t2rgb | pass |" in (tmp_path / "summary").read_text()
    assert (output / "summary.md").read_text().strip() == (tmp_path / "summary").read_text().strip()


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_everything_that_was_started(number: signal.Signals, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "calibration", "calibrate-matrix", "--dataset", T2RGB]
    arguments = ["--seeds", "100000", "--jobs", "2", "--output", str(tmp_path)]
    process = subprocess.Popen(
        [*command, *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # background jobs of a shell ignore SIGINT
    )
    try:
        deadline = time.monotonic() + 60
        while not list(tmp_path.glob("t2rgb/*/dataset.json")) and time.monotonic() < deadline:
            time.sleep(0.05)
        os.kill(process.pid, number)
        _, error = process.communicate(timeout=60)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()

    assert process.returncode == 128 + number
    assert error.strip().endswith(f"stopped by {number.name}")
    wait_until(lambda: not group_runs(process.pid), "no process of its session is left")
