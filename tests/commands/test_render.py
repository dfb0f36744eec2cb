"""``--render kubernetes``: what would run on AWS Batch, written down for a cluster."""

import json
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from calibration.__main__ import main
from tests.execution.batch.samples import ACCOUNT

ROOT = Path(__file__).parents[2]
T2RGB = str(ROOT / "datasets" / "t2rgb")
WORLDS = (
    "--scenario-set",
    str(ROOT / "datasets" / "scenarios.yml"),
    "--scenarios",
    "2",
    "--image",
    "team/calibration:1",
)
SOFTWARE = ("--image", "team/robot:1", "--command", "calibrate {start} {output}", "--artifacts", "{output}/*")
SECTION = {
    "region": "eu-west-1",
    "queue": "robots",
    "bucket": "team-robots",
    "tools-image": "team/tools:1",
    "job-role": f"arn:aws:iam::{ACCOUNT}:role/job",
    "execution-role": f"arn:aws:iam::{ACCOUNT}:role/execution",
}


@pytest.fixture
def section(tmp_path: Path) -> str:
    file = tmp_path / "aws.yml"
    file.write_text(yaml.safe_dump({"aws-batch": SECTION}))
    return str(file)


def rendered(output: Path) -> list[dict[str, Any]]:
    """The entries of the jobs; the manifests are held to the schema."""
    folder = output / "kubernetes"
    for manifest in yaml.safe_load_all((folder / "jobs.yaml").read_text()):
        kubernetes_validate.validate(manifest, "1.29", strict=True)
    files = sorted(folder.glob("objects/calibration/runs/*/jobs/*/*.json"))
    return [entry for file in files for entry in json.loads(file.read_text())]


def test_worlds(tmp_path: Path, section: str, capsys: pytest.CaptureFixture[str]) -> None:
    to = ("--aws-batch", section, "--run", "r1", "--output", str(tmp_path / "out"))
    assert main(["collect-data-sim", "--system", T2RGB, *WORLDS, "--render", "kubernetes", *to]) == 0
    assert "run r1: 2 jobs for Kubernetes; what to do with them" in capsys.readouterr().out
    first, second = rendered(tmp_path / "out")
    assert [first["job"], second["job"]] == ["s1-00000", "s1-00001"]
    assert first["containers"][0]["command"][:2] == ["calibration", "collect-data-sim"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["kubernetes", "run.txt"]
    assert (tmp_path / "out" / "run.txt").read_text() == "r1\n"


def test_applications(tmp_path: Path, section: str) -> None:
    commands = ("--simulation-command", "simulate", "--robot-command", "collect {motion}", "--image", "team/robot:1")
    to = ("--aws-batch", section, "--output", str(tmp_path / "out"))
    assert main(["collect-data-sim", "--system", T2RGB, *commands, "--render", "kubernetes", *to]) == 0
    [entry] = rendered(tmp_path / "out")
    assert [each["name"] for each in entry["containers"]] == ["simulation", "robot"]
    assert entry["containers"][1]["command"] == ["collect", "/calibration/in/motion.json"]
    assert not list((tmp_path / "out").glob("*.json"))


def test_a_matrix(tmp_path: Path, section: str) -> None:
    noise = ("--translation-noise", "0,0.5", "--rotation-noise", "0,0.5")
    to = ("--aws-batch", section, "--output", str(tmp_path / "out"))
    assert main(["calibrate-matrix", "--dataset", T2RGB, *SOFTWARE, *noise, "--render", "kubernetes", *to]) == 0
    entries = rendered(tmp_path / "out")
    assert len(entries) == 4
    assert (
        len({entry["mounts"][1]["sha256"] for entry in entries})
        + len({entry["mounts"][0]["sha256"] for entry in entries})
        == 5
    )  # one dataset, four starts
    assert not (tmp_path / "out" / "results.json").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("calibrate-matrix", "--dataset", T2RGB), "render: a cluster runs the team's own software"),
        (
            ("calibrate-matrix", "--dataset", T2RGB, *SOFTWARE, "--backend", "docker"),
            "error: render: ",
        ),
        (
            ("collect-data-sim", "--system", T2RGB, *WORLDS, "--backend", "docker"),
            "render: writes what would run on aws-batch, and runs nothing: leave out backend docker",
        ),
        (("collect-data-sim", "--system", T2RGB, *WORLDS, "--resume"), "leave out resume"),
        (("collect-data-sim", "--system", T2RGB, "--backend", "embedded"), "render: is for containers"),
        (("collect-data-sim", "--system", T2RGB), "backend: found aws-batch; it runs the team's applications"),
    ],
)
def test_what_cannot_be_rendered(
    arguments: tuple[str, ...], message: str, tmp_path: Path, section: str, capsys: pytest.CaptureFixture[str]
) -> None:
    to = ("--aws-batch", section, "--output", str(tmp_path / "out"))
    assert main([*arguments, "--render", "kubernetes", *to]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out" / "kubernetes").exists()
