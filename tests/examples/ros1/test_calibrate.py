"""The team's calibration: as it is run, in a process of its own, and its failures, here."""

import csv
import json
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import calibrate as program
import numpy as np
import pytest

from calibration.base.tables import judge, parse_rules, read_table
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.evaluation.two_sensors import rgb_to_rgb
from calibration.engine.geometry.transforms import distance
from tests.examples.ros1.conftest import EXAMPLE, Collected

TABLE = "rgb_to_rgb_results.csv"


def calibrate(dataset: Path, output: Path, *more: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, EXAMPLE / "robot" / "calibrate.py", "--dataset", dataset, "--output", output, *more]
    variables = {**os.environ, **environment}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=variables)


def calibrate_here(dataset: Path, output: Path, *more: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """The same without a process, which would have to import scipy first."""
    command = ["calibrate.py", "--dataset", str(dataset), "--output", str(output), *more]
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", command)
        for name, value in environment.items():
            patch.setenv(name, value)
        code = program.main()
    return subprocess.CompletedProcess(command, code, out.getvalue(), err.getvalue())


def error_mm(calibrated: Dataset, truth: Dataset) -> float:
    """Between the two cameras."""
    frames = "left_camera_optical", "right_camera_optical"
    return float(1000 * distance(truth.transform(*frames)[0], calibrated.transform(*frames)[0])[0])


def noisy(size: str, seed: str) -> tuple[str, ...]:
    return ("--translation-noise", size, "--rotation-noise", size, "--seed", seed)


@pytest.fixture(scope="module")
def calibrated_from(collected: Collected, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """What comes of the dataset, by the noise on its start, with seed 3."""
    before = (collected.folder / "dataset.json").read_bytes()
    found = {}
    for size in ("0", "0.1"):
        found[size] = tmp_path_factory.mktemp("calibrated")
        done = calibrate(collected.folder, found[size], *noisy(size, "3"))
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith(f"calibrated 2 cameras from {len(collected.dataset.keys)} collections: RMS 0.0")
    assert (collected.folder / "dataset.json").read_bytes() == before
    return found


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("size", ["0", "0.1"])
def test_it_finds_the_truth_from_every_noisy_start(
    collected: Collected, calibrated_from: dict[str, Path], size: str
) -> None:
    folder = calibrated_from[size]
    calibrated = read_dataset(folder)
    assert error_mm(calibrated, collected.dataset) < 0.2
    ours = rgb_to_rgb(calibrated, "right_camera", "left_camera")
    header, *rows, averages = csv.reader((folder / TABLE).read_text().splitlines())
    assert header == ["Collection #", *ours.columns]
    assert [row[0] for row in rows] == list(ours.labels)
    values = np.array([row[1:] for row in rows], float)
    np.testing.assert_allclose(values, ours.values, rtol=0.005, atol=1e-3)
    assert averages[0] == "Averages"
    np.testing.assert_allclose(np.array(averages[1:], float), values.mean(0), atol=6e-5)


@pytest.mark.thorough
def test_the_noise_depends_on_the_seed_alone(
    collected: Collected, calibrated_from: dict[str, Path], tmp_path: Path
) -> None:
    for folder, seed in (("b", "3"), ("c", "2")):
        assert calibrate_here(collected.folder, tmp_path / folder, *noisy("0.1", seed)).returncode == 0
    folders = calibrated_from["0.1"], tmp_path / "b", tmp_path / "c"
    a, b, c = (json.loads((folder / "dataset.json").read_text()) for folder in folders)
    # nothing ties the cameras to the world, so the first stays where the noise has put it
    assert a == b
    left = "stand-left_camera"
    assert a["collections"]["000"]["transforms"][left] != c["collections"]["000"]["transforms"][left]


@pytest.mark.thorough
def test_broken_software_fails_the_rule_and_is_far_from_the_truth(
    collected: Collected, calibrated_from: dict[str, Path], tmp_path: Path
) -> None:
    rules = parse_rules([{"column": "RMS (pix)", "row": "Averages", "min": 0, "max": 0.5}], where="rules")
    assert calibrate_here(collected.folder, tmp_path, ROBOT_BUG="1").returncode == 0
    for folder, passes in ((calibrated_from["0"], True), (tmp_path, False)):
        assert judge(read_table(folder / TABLE), rules).passed is passes
    assert error_mm(read_dataset(tmp_path), collected.dataset) > 5


@pytest.mark.parametrize(
    ("content", "error"),
    [(None, "FileNotFoundError"), ("{", "JSONDecodeError"), ("{}", "KeyError: 'calibration_config'")],
)
def test_what_is_no_dataset_is_a_failure_in_one_line(tmp_path: Path, content: str | None, error: str) -> None:
    if content is not None:
        (tmp_path / "dataset.json").write_text(content)
    done = calibrate_here(tmp_path, tmp_path / "output")
    assert done.returncode == 1
    assert done.stderr.startswith(f"calibrate: {error}")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "output").exists()


def test_a_camera_that_saw_nothing_is_a_failure(collected: Collected, tmp_path: Path) -> None:
    document = json.loads((collected.folder / "dataset.json").read_text())
    for collection in document["collections"].values():
        collection["labels"]["board"]["right_camera"] = {"detected": False, "idxs": []}
    (tmp_path / "dataset.json").write_text(json.dumps(document))
    done = calibrate_here(tmp_path, tmp_path / "output")
    assert done.returncode == 1
    assert "right_camera and left_camera saw the board together in no collection" in done.stderr
