"""The team's applications many times, in real containers: each is told its number, and sees its inputs as a folder."""

import json
import shutil
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionRequest

PROJECT = Path(__file__).parents[3]
# A simulation that tells of its scenario, and a robot application whose third collection fails.
SIMULATION = """
import os, sys, time
with open("/calibration/output/scenario", "w") as file:
    file.write(sys.argv[1])
print("ready", flush=True)
time.sleep(600)
"""
ROBOT = """
import json, os, shutil, sys
motion, output, scenario, seed = sys.argv[1:]
assert os.listdir("/calibration/in") == ["motion.json"], os.listdir("/calibration/in")
assert len(json.load(open(motion))) == 4
assert open("/calibration/output/scenario").read() == scenario
if scenario == "2":
    sys.exit("no board was seen with seed " + seed)
shutil.copytree("/collected", output + "/dataset")
"""


@pytest.fixture
def applications(tmp_path: Path, python_image: str) -> Path:
    collected = tmp_path / "collected"
    collect_dataset(CollectionRequest(PROJECT / "datasets" / "t2rgb", motion="generate:4", seed=3), collected, jobs=1)
    shutil.copy(collected / "motion.json", tmp_path / "four.json")
    for name in ("ground_truth.json", "motion.json"):
        (collected / name).unlink()
    for name, program in (("simulation", SIMULATION), ("robot", ROBOT)):
        (tmp_path / "programs" / name).mkdir(parents=True)
        (tmp_path / "programs" / name / "main.py").write_text(program)
    path = tmp_path / "applications.yml"
    document = {
        "image": python_image,
        "containers": {
            "simulation": {
                "command": ["python3", "/programs/main.py", "{scenario}"],
                "mounts": ["programs/simulation:/programs"],
                "ready": {"log": "ready"},
                "essential": False,
            },
            "robot": {
                "command": ["python3", "/programs/main.py", "{motion}", "{output}", "{scenario}", "{seed}"],
                "mounts": ["programs/robot:/programs", "collected:/collected"],
                "after": ["simulation"],
            },
        },
    }
    path.write_text(json.dumps(document))
    return path


@pytest.mark.thorough
def test_three_of_which_one_fails(applications: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    system = str(PROJECT / "datasets" / "t2rgb")
    words = ["collect-data-sim", "--system", system, "--applications", str(applications), "--seed", "3"]
    words += ["--motion", str(tmp_path / "four.json")]
    output = tmp_path / "out"
    assert main([*words, "--scenarios", "3", "--jobs", "2", "--output", str(output)]) == 1
    out, err = capsys.readouterr()
    assert out.startswith("t2rgb: 3 datasets of the applications, seed 3\n")
    document = json.loads((output / "results.json").read_text())
    [(scenario, [why])] = document["failed"].items()
    assert scenario == "s3-00002"
    assert why == "container 'robot' ended with exit code 1: no board was seen with seed 3"
    assert f"warning: {scenario}: {why}" in err
    assert [each["converged"] for each in document["scenarios"]] == [True, True, False]
    assert (output / "logs" / scenario / "robot.log").read_text() == "no board was seen with seed 3\n"
    assert (output / "scenarios" / "s3-00001" / "contact_sheet.png").exists()
    [replay] = [line for line in (output / "summary.md").read_text().splitlines() if f"--scenario {scenario}" in line]
    assert f"--applications {applications}" in replay

    assert main([*words, "--scenario", "s3-00001", "--output", str(tmp_path / "one")]) == 0
    alone, kept = tmp_path / "one" / "dataset.json", output / "scenarios" / "s3-00001" / "dataset.json"
    assert alone.read_bytes() == kept.read_bytes()
    enough = ("--resume", "--minimum-success-rate", "0.6")
    assert main([*words, "--scenarios", "3", *enough, "--output", str(output)]) == 0
