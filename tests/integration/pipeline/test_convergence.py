"""`convergence` of the team's software in real containers: what it converges from, beside our engine."""

import csv
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from calibration.__main__ import main

if TYPE_CHECKING:
    from docker import DockerClient

DATASET = Path(__file__).parents[3] / "datasets" / "t2rgb"
# Comes to 0.5 px from near, to 5 px, another optimum, from 1 rad, and to nothing from 1 m.
SOFTWARE = """
import sys
translation, rotation, output = float(sys.argv[1]), float(sys.argv[2]), sys.argv[3]
if translation >= 1:
    sys.exit("no convergence")
rms = 5 if rotation >= 1 else 0.5
with open(output + "/results.csv", "w") as file:
    file.write("Collection #,RMS (pix)\\n000,%f\\nAverages,%f\\n" % (rms, rms))
"""
COMMAND = f"python3 -c {shlex.quote(SOFTWARE)} {{translation_noise}} {{rotation_noise}} {{output}}"
GRID = ["--translation-noise", "1", "--rotation-noise", "1", "--seeds", "1"]


@pytest.fixture
def sweep(tmp_path: Path, python_image: str, engine: "DockerClient") -> Callable[..., int]:
    def run(*options: str, command: str = COMMAND) -> int:
        words = [
            "convergence",
            "--dataset",
            str(DATASET),
            "--image",
            python_image,
            "--command",
            command,
            *GRID,
            "--calibrated",
            "none",
        ]
        return main([*words, "--output", str(tmp_path / "out"), *options])

    return run


def results(tmp_path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((tmp_path / "out" / "results.json").read_text())
    return found


def test_software_is_swept_once_with_our_engine_beside_it(
    sweep: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert sweep("--start", "given,linear") == 0

    found = results(tmp_path)
    assert [(each["method"], each["start"], each["judged"]) for each in found["maps"]] == [
        ("calibration-ci", "given", False),
        ("software", "given", True),
        ("calibration-ci", "linear", False),
    ]
    [theirs] = [each for each in found["maps"] if each["judged"]]
    reasons = {
        (pair["translation_noise"], pair["rotation_noise"]): [why for lost in pair["lost"] for why in lost["reasons"]]
        for pair in theirs["pairs"]
    }
    assert reasons[0, 0] == []
    assert reasons[0, 1] == ["another optimum: RMS 5.0000 px, while 0.5000 px can be reached"]
    assert "no convergence" in reasons[1, 0][0]
    assert found["largest"] == {
        "translation_noise": 0,
        "rotation_noise": 0,
        "diagonal": {"translation_noise": 0, "rotation_noise": 0},
    }
    kept = tmp_path / "out" / "cells" / "t2rgb" / "translation-1_rotation-0_seed-1" / "logs" / "calibration.log"
    assert "no convergence" in kept.read_text()
    assert not list((tmp_path / "out").rglob("dataset.json"))
    with (tmp_path / "out" / "largest-noise.csv").open() as file:
        assert [row["Map"] for row in csv.DictReader(file)][1] == "t2rgb, software, given"
    assert "t2rgb, software, given" in capsys.readouterr().out


def test_software_whose_table_says_nothing_does_not_pass(sweep: Callable[..., int], tmp_path: Path) -> None:
    program = "import sys; open(sys.argv[1] + '/t.csv', 'w').write('Name,Value\\na,1\\n')"
    command = f'python3 -c "{program}" {{output}}'
    options = ["--translation-noise", "0", "--rotation-noise", "0", "--start", "given"]
    assert sweep(*options, command=command) == 1
    assert "no criterion for convergence" in results(tmp_path)["reasons"][0]
