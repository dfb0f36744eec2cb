"""`calibrate-matrix` with the team's software in real containers: the verdict, the exit code, and what is left."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.docker_engine import wait_until

if TYPE_CHECKING:
    from docker import DockerClient

PROJECT = Path(__file__).parents[3]
DATASET = PROJECT / "datasets" / "t2rgb"
# Writes a table whose RMS tells the noise that it was given, and how far the start is from the dataset.
SOFTWARE = """
import json, math, sys
dataset, start, output, translation, rotation, seed = sys.argv[1:]
edge = "left_tripod_base-left_camera"
def place(folder):
    with open(folder + "/dataset.json") as file:
        transforms = next(iter(json.load(file)["collections"].values()))["transforms"]
    return [entry["trans"] for key, entry in sorted(transforms.items())]
moved = max(math.dist(a, b) for a, b in zip(place(dataset), place(start)))
rms = float(translation) + 10 * float(rotation) + 100 * int(seed)
with open(output + "/results.csv", "w") as file:
    file.write("Collection #,RMS (pix),Moved\\n000,%f,%f\\nAverages,%f,%f\\n" % (rms, moved, rms, moved))
"""
ARGUMENTS = "{dataset} {start} {output} {translation_noise} {rotation_noise} {seed}"


@pytest.fixture
def matrix(
    tmp_path: Path, python_image: str, engine: "DockerClient"
) -> Callable[..., subprocess.CompletedProcess[str]]:
    def run(command: str, *options: str, **variables: str) -> subprocess.CompletedProcess[str]:
        words = [sys.executable, "-m", "calibration", "calibrate-matrix", "--dataset", str(DATASET)]
        words += ["--image", python_image, "--command", command, "--output", str(tmp_path / "out")]
        words += [] if "--calibrated" in options else ["--calibrated", "none"]
        words += options
        return subprocess.run(
            words,
            cwd=PROJECT,
            env={**os.environ, **variables},
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )

    return run


def python(program: str, arguments: str = ARGUMENTS) -> str:
    import shlex

    return f"python3 -c {shlex.quote(program.replace('{', '{{').replace('}', '}}'))} {arguments}"


def results(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return document


def errors(run: subprocess.CompletedProcess[str]) -> list[str]:
    return [line for line in run.stderr.splitlines() if line.startswith("error")]


def test_each_cell_has_its_own_start_table_and_verdict(
    matrix: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    run = matrix(python(SOFTWARE), "--translation-noise", "0,0.5", "--rotation-noise", "0,0.1", "--seed-list", "3")
    assert run.returncode == 0, run.stdout + run.stderr
    document = results(tmp_path / "out")
    cells = document["cells"]
    assert [cell["rms_px"] for cell in cells] == [300.0, 301.0, 300.5, 301.5]
    assert {cell["method"] for cell in cells} == {"software"}
    tables = [(tmp_path / "out" / cell["table"]).read_text() for cell in cells]
    assert len(set(tables)) == 4
    moved = [float(table.splitlines()[-1].split(",")[-1]) for table in tables]
    assert moved == pytest.approx([0, 0, 0.5, 0.5], abs=1e-6)
    references = document["comparisons"]
    assert [cell["method"] for cell in references] == ["calibration-ci"] * 4
    assert all(cell["converged"] and cell["rms_px"] < 1 for cell in references)
    assert "t2rgb: software" in run.stdout
    for cell in cells:
        folder = (tmp_path / "out" / cell["table"]).parents[1]
        assert (folder / "logs" / "calibration.log").exists()
        assert json.loads((folder / "manifest.json").read_text())
    assert not list((tmp_path / "out").glob(".starts-*"))


def test_a_rule_that_the_table_breaks_is_red_and_our_engine_tells_why(
    matrix: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    rules = tmp_path / "rules.yml"
    rules.write_text("- {column: RMS (pix), row: Averages, max: 3}\n")
    run = matrix(python(SOFTWARE), "--rules", str(rules))
    assert run.returncode == 1
    line, fault = errors(run)
    assert "found 100" in line
    assert "our engine passes on the same data from the same start" in fault


def test_the_start_returned_beside_a_good_table_is_red_with_the_distance(
    matrix: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    """A good table alone would have passed."""
    program = (
        "import shutil, sys; start, output = sys.argv[1:]; shutil.copy(start + '/dataset.json', output); "
        "open(output + '/results.csv', 'w').write('Collection #,RMS (pix)\\n000,0.1\\nAverages,0.1\\n')"
    )
    command = python(program, "{start} {output}")
    run = matrix(command, "--calibrated", "dataset.json", "--translation-noise", "0.5")
    assert run.returncode == 1, run.stdout + run.stderr
    line, fault = errors(run)
    assert "far from our optimum on the same labels: 'left_camera' to 'right_camera' by " in line
    assert "It has returned its start unchanged" in line
    assert "our engine passes on the same data from the same start" in fault
    [cell] = results(tmp_path / "out")["cells"]
    assert cell["findings"][0]["moves_mm"] > 100


@pytest.mark.thorough(but_first=3)
@pytest.mark.parametrize(
    ("program", "options", "code", "says"),
    [
        ("import sys; print('no board'); sys.exit(3)", (), 1, "ended with exit code 3"),
        ("import os; os.kill(os.getpid(), 9)", (), 1, "SIGKILL"),
        ("x = bytearray(10**9)", ("--memory", "64m"), 1, "memory"),
        ("import time; time.sleep(60)", ("--timeout", "1s"), 3, "1 s"),
        ("", (), 1, "/calibration/output/*"),
        ("open('/calibration/output/a.txt', 'w')", (), 1, "expected exactly one file '*.csv'"),
        ("import os; os.symlink('/etc/passwd', '/calibration/output/a.csv')", (), 1, "a.csv"),
    ],
)
def test_what_goes_wrong_in_a_cell_is_one_line_and_its_exit_code(
    matrix: Callable[..., subprocess.CompletedProcess[str]],
    program: str,
    options: tuple[str, ...],
    code: int,
    says: str,
) -> None:
    run = matrix(python(program, ""), *options)
    assert run.returncode == code, run.stdout + run.stderr
    line, *whose_fault = errors(run)
    assert len(whose_fault) == (code == 1)
    assert says in line
    assert "Traceback" not in run.stdout + run.stderr


def test_an_image_that_there_is_not(matrix: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    run = matrix("true", "--image", "127.0.0.1:1/no/such:image")
    assert run.returncode in (2, 3)
    [line] = errors(run)
    assert "127.0.0.1:1/no/such:image" in line


def test_without_an_engine_it_says_so_at_once(matrix: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    run = matrix("true", DOCKER_HOST="unix:///nowhere.sock")
    assert run.returncode == 3
    [line] = errors(run)
    assert "Docker" in line
    assert "unix:///nowhere.sock" in line


def test_sigterm_leaves_nothing_behind(python_image: str, engine: "DockerClient", tmp_path: Path) -> None:
    words = [sys.executable, "-m", "calibration", "calibrate-matrix", "--dataset", str(DATASET), "--seeds", "2"]
    words += ["--image", python_image, "--command", "sleep 60", "--output", str(tmp_path)]

    def containers() -> list[Any]:
        return [
            c
            for c in engine.containers.list(all=True, ignore_removed=True)  # others' come and go
            if c.attrs["Config"]["Cmd"] == ["sleep", "60"]
            and any(str(tmp_path) in mount.get("Source", "") for mount in c.attrs["Mounts"])
        ]

    with subprocess.Popen(words, cwd=PROJECT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        wait_until(lambda: bool(containers()), "a container runs")
        process.send_signal(signal.SIGTERM)
        _, stderr = process.communicate(timeout=60)
    assert process.returncode == 143
    assert "stopped by SIGTERM" in stderr
    assert containers() == []


def test_a_planted_secret_is_in_no_log_result_or_summary(python_image: str, tmp_path: Path) -> None:
    program = "import os, sys; print('key', os.environ['API_KEY']); sys.exit(os.environ['API_KEY'])"
    (tmp_path / "calibration.yml").write_text(
        f"systems:\n  t2rgb:\n    dataset: {DATASET}\n    software:\n      image: {python_image}\n"
        f"      secrets: [API_KEY]\n      command: [python3, -c, {json.dumps(program)}]\n"
    )
    planted, summary = "planted-7f3a9c", tmp_path / "step-summary.md"
    done = subprocess.run(
        [sys.executable, "-m", "calibration", "run", "--config", "calibration.yml", "--output", "out"],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": str(PROJECT),
            "API_KEY": planted,
            "GITHUB_ACTIONS": "true",
            "GITHUB_STEP_SUMMARY": str(summary),
        },
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 1
    texts = [done.stderr, summary.read_text()]
    texts += [line for line in done.stdout.splitlines() if not line.startswith("::add-mask::")]
    texts += [path.read_text() for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert not [text for text in texts if planted in text]
    [log] = (tmp_path / "out").rglob("calibration.log")
    assert "key ***" in log.read_text()


@pytest.mark.thorough
def test_software_that_becomes_worse_on_the_same_data_is_red_against_what_was_accepted(
    python_image: str, engine: "DockerClient", tmp_path: Path
) -> None:
    """The tables of two images on the same data and starts, paired by start."""

    def command(*arguments: str, loss: float = 1.0) -> subprocess.CompletedProcess[str]:
        program = SOFTWARE.replace("* int(seed)\n", f"* int(seed) * {loss}\n")
        document = {
            "noise": {"translation": [0, 0.5]},
            "systems": {
                "robot": {
                    "dataset": str(DATASET),
                    "truth": "none",
                    "software": {"image": python_image, "command": python(program), "calibrated": "none"},
                }
            },
        }
        (tmp_path / "calibration.yml").write_text(json.dumps(document))
        return subprocess.run(
            [sys.executable, "-m", "calibration", *arguments],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(PROJECT)},
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )

    first = command("run")
    assert first.returncode == 0, first.stderr
    assert command("accept").returncode == 0
    accepted = json.loads((tmp_path / "calibration-baseline.json").read_text())["systems"]["robot"]
    assert [start["rms-px"] for start in accepted["software"]] == [100.0, 100.5]
    assert command("run", loss=1.04).returncode == 0
    worse = command("run", loss=1.06)
    assert worse.returncode == 1
    assert "worse than the baseline: RMS: found 106 px, expected at most 105 px (baseline 100)" in worse.stderr
