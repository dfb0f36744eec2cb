"""Every action as a user's workflow runs it: green, red in every way, with hostile inputs, for a stranger's change."""

import json
import secrets
import shutil
import socket
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml

from tests.docker_engine import Registry

from .conftest import PROJECT, Repository, Run
from .steps import Step, outcome, outcomes, workflow

projects = pytest.importorskip("tests.addons.coverage.projects")
TOKEN, codacy = projects.TOKEN, projects.codacy

if TYPE_CHECKING:
    from docker import DockerClient

NO_DOCKER = {"DOCKER_HOST": "unix:///nowhere.sock"}
EVALUATE = "rgb-to-rgb:left_camera:right_camera"
PIPELINE = {"systems": {"tripod": {"dataset": "my robot", "evaluate": EVALUATE}}}
SOFTWARE = {"systems": {"tripod": {"dataset": "my robot", "software": {"command": ["calibrate"], "image": "robot:1"}}}}
BOARD = {"type": "charuco", "columns": 11, "rows": 8, "square": 0.06, "marker": 0.045, "dictionary": "DICT_5X5_100"}
IMPORT = {
    "sensors": {
        name: {"images": f"my images/{name}_*", "intrinsics": "my camera.yml"}
        for name in ("left_camera", "right_camera")
    },
    "patterns": {"board": BOARD},
}
PYTHON = {
    "my package/naming.py": "def name(a, b):\n    return f'{a}-{b}'\n\n\ndef unused():\n    return 1\n",
    "my package/test_naming.py": (
        "import unittest\n\nimport naming\n\n\nclass Test(unittest.TestCase):\n"
        "    def test_name(self):\n        self.assertEqual(naming.name(1, 2), '1-2')\n"
    ),
}
FILES = {
    "my table.csv": "Collection #,RMS (pix),X err (pix)\n000,0.5,0.1\n001,0.7,0.2\nAverages,0.6,0.1\n",
    "my limits.yml": "rules:\n- {column: RMS (pix), row: Averages, max: 0.01}\n",
    "my pipeline.yml": json.dumps(PIPELINE),
    "my import.yml": json.dumps(IMPORT),
    "my camera.yml": "intrinsics: {fx: 554.256, fy: 554.256, cx: 320.5, cy: 240.5}\n",
    "my robot": PROJECT / "datasets" / "t2rgb",
    **PYTHON,
}
HOSTILE = """$(touch pwned) `touch pwned`"; touch pwned; '; touch pwned; #
::error::injected
::set-output name=verdict::pass
::set-env name=INJECTED::yes
::add-mask::robot"""


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """Return a folder with photographs of two cameras."""
    folder = tmp_path / "photographs"
    folder.mkdir()
    for path in (PROJECT / "datasets" / "t2rgb").glob("*_camera_00?.jpg"):
        shutil.copy(path, folder / f"{path.stem}.jpeg")  # a repository gets no .jpg here
    return folder


def declared(action: str) -> set[str]:
    """Return the outputs that an action.yml declares."""
    path = PROJECT / "actions" / action if action else PROJECT
    return set(yaml.safe_load((path / "action.yml").read_text())["outputs"])


@pytest.fixture
def image(engine: "DockerClient") -> Iterator[str]:
    """Return a name for an image, which is removed."""
    name = f"act-test-{secrets.token_hex(4)}"
    yield name
    for built in engine.images.list(name):
        engine.images.remove(built.id, force=True)


def specification(base: str) -> str:
    return json.dumps({"image": {"base": base, "files": [{"from": "my table.csv", "to": "/opt/my table.csv"}]}})


def green(registry: Registry, server: str, **more: str) -> list[Step]:
    """Return a step for every action, with more inputs; Codacy is told only on a push, with the secrets it has."""
    image = {"spec": "my image.yml", "name": f"{registry.address}/green", "output": "the image"}
    matrix = {"dataset": "my robot", "translation-noise": "0, 0.5", "evaluate": EVALUATE, "output": "the matrix"}
    collection = {"system": "my robot", "motion": "generate:4", "seed": "3", "output": "the collection"}
    sweep = {
        "dataset": "my robot",
        "translation-noise": "0.2",
        "rotation-noise": "0",
        "seeds": "2",
        "output": "the sweep",
    }
    coverage = {"run": "python3 -m unittest", "directory": "my package", "output": "the coverage", "badge": "badge.svg"}
    averages = {"column": "RMS (pix)", "row": "Averages", "max": "3"}
    tables = "${{ steps.matrix.outputs.output }}/**/rgb_to_rgb_results.csv"
    steps = [
        Step("table", "introspect-csv", {"file": "my table.csv", **averages, "output": "the report"}),
        Step(
            "coverage",
            "coverage-upload",
            coverage
            | {"minimum": "70", "service": "codacy", "project-token": "${{ secrets.CODACY }}", "api-url": server},
        ),
        Step("image", "build-image", image | {"push": "${{ github.event_name == 'push' }}"}),
        Step("matrix", "calibrate-matrix", matrix),
        Step("tables", "introspect-csv", {"file": tables, **averages}),
        Step("collection", "collect-data-sim", collection),
        Step("sweep", "convergence", sweep),
        Step("import", "import-data", {"config": "my import.yml", "output": "the import"}),
        Step("pipeline", "", {"config": "my pipeline.yml", "output": "the pipeline"}),
    ]
    return [replace(step, inputs={**step.inputs, **more}) for step in steps]


WRITTEN = """
for file in "the "{report,coverage,image,matrix,collection,sweep,import,pipeline}/results.json badge.svg; do
    test -s "$file" || echo "missing: $file"
done
"""


def check_green(run: Run, steps: list[Step]) -> dict[str, dict[str, str]]:
    """Hold every step to being green, and return their outputs."""
    assert run.code == 0, run.log
    assert outcomes(run) == {step.id: "success" for step in steps}, run.log
    assert not [line for line in run.printed if line.startswith("missing: ")]
    assert run.annotations == []
    outputs = {step.id: outcome(run, step).outputs for step in steps}
    assert {name: found["verdict"] for name, found in outputs.items()} == {step.id: "pass" for step in steps}
    for step in steps:
        assert set(outputs[step.id]) == declared(step.action)
    return outputs


def check_results(outputs: dict[str, dict[str, str]]) -> None:
    """Hold the outputs of all steps to what the inputs lead to."""
    assert outputs["table"]["violations"] == outputs["tables"]["violations"] == "0"
    assert float(outputs["matrix"]["success-rate"]) == float(outputs["pipeline"]["success-rate"]) == 1
    assert 0 < float(outputs["matrix"]["worst-rms-px"]) < 3
    assert outputs["collection"]["collections"] == "4"
    assert float(outputs["sweep"]["largest-translation-noise"]) == 0.2
    assert outputs["import"]["collections"] == "10"
    assert outputs["coverage"]["line-rate"] == "75.0"


def test_every_action_is_green_on_a_push_and_for_a_stranger(
    repository: Repository, base_image: str, registry: Registry, images: Path
) -> None:
    with codacy() as server:
        steps = green(registry, server.url)
        files = FILES | {"my image.yml": specification(base_image), "my images": images}
        run = repository.push(workflow(steps, WRITTEN), files, "--secret", f"CODACY={TOKEN}")
        outputs = check_green(run, steps)
        check_results(outputs)
        assert outputs["image"]["digest"].startswith("sha256:")
        assert outputs["coverage"]["uploaded"] == "uploaded"
        assert [asked.headers["project-token"] for asked in server.asked] == [TOKEN]
        assert TOKEN not in run.log
        # Each brought its own environment, which has all that it needs; the second table found the first one's.
        assert run.installations == ["introspect", "coverage", "image", "engine", "run"]

        # For a stranger, those whose work depends on the event; with an environment of the user's own.
        eventful = ("table", "coverage", "image", "pipeline")
        steps = [step for step in green(registry, server.url, python=sys.executable) if step.id in eventful]
        repository.write(workflow(steps), {})
        run = repository.pull_request_from_a_fork()
        outputs = check_green(run, steps)
        assert run.installations == []
        assert outputs["table"]["violations"] == "0"
        assert float(outputs["pipeline"]["success-rate"]) == 1
        assert outputs["image"]["digest"] == ""
        assert outputs["coverage"]["uploaded"] == "skipped"
        assert len(server.asked) == 1


@pytest.mark.thorough
def test_actions_are_green_in_a_plain_image(
    repository: Repository, plain_image: str, base_image: str, registry: Registry
) -> None:
    """Those that need an environment, an engine, and the repository's files; the others run as these do."""
    with codacy() as server:
        every = {step.id: step for step in green(registry, server.url)}
        steps = [every[name] for name in ("pipeline", "coverage", "image", "collection")]
        repository.write(workflow(steps), FILES | {"my image.yml": specification(base_image)})
        run = repository.act_in(plain_image, "--secret", f"CODACY={TOKEN}")
        outputs = check_green(run, steps)
        assert outputs["collection"]["collections"] == "4"
        # Within it the engine is that of the machine.
        assert outputs["image"]["digest"].startswith("sha256:")
        assert run.installations == ["engine", "coverage", "image", "run"]

    repository.write(workflow(steps[:1]), {})
    run = repository.act_in(base_image)  # which has no Python
    came = outcome(run, steps[0])
    [annotation] = came.annotations
    assert came.code == 3, came.log
    assert "no Python >= 3.11 on this machine" in annotation


@pytest.fixture
def refused() -> Iterator[str]:
    """Return an address where nothing answers."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield f"http://127.0.0.1:{taken.getsockname()[1]}"


@pytest.mark.thorough
def test_actions_are_red_in_every_way(repository: Repository, base_image: str, image: str, refused: str) -> None:
    """1: the verdict; 2: the input; 3: the infrastructure. Each says in one annotation what is wrong."""
    averages = {"file": "my table.csv", "column": "RMS (pix)", "row": "Averages"}
    matrix = {"dataset": "my robot", "evaluate": EVALUATE}
    collection = {"system": "my robot", "motion": "generate:3"}
    coverage = {"run": "python3 -m unittest", "directory": "my package"}
    files = {
        "worse.yml": json.dumps({**PIPELINE, "limits": {"rms-px": 0.001}}),
        "software.yml": json.dumps(SOFTWARE),
        "Dockerfile": f"FROM {base_image}\nRUN exit 7\n",
        "image.yml": specification(base_image),
    }
    # An action's input, its exit code, and what its annotation says.
    cases = [
        (Step("root-1", "", {"config": "worse.yml"}), 1, ["RMS", "at most 0.001 px"]),
        (Step("root-3", "", {"config": "software.yml"}, NO_DOCKER), 3, ["Docker"]),
        (
            Step("introspect-1", "introspect-csv", averages | {"max": "0.55"}),
            1,
            ["file=my table.csv", "line=4", "0.6", "0.55"],
        ),
        (
            Step("introspect-3", "introspect-csv", averages | {"max": "1", "output": "my table.csv/out"}),
            3,
            ["my table.csv/out"],
        ),
        (Step("matrix-1", "calibrate-matrix", matrix | {"rules": "my limits.yml"}), 1, ["Calibration", "0.01"]),
        (Step("matrix-2", "calibrate-matrix", {"dataset": "nowhere"}), 2, ["nowhere"]),
        (Step("collect-2", "collect-data-sim", collection | {"system": "my rebot", "output": "x"}), 2, ["my rebot"]),
        (
            Step(
                "collect-3",
                "collect-data-sim",
                {
                    "system": "my robot",
                    "output": "y",
                    "backend": "docker",
                    "image": image,
                    "simulation-command": "simulate",
                    "robot-command": "collect",
                },
                NO_DOCKER,
            ),
            3,
            ["Docker"],
        ),
        (
            Step("image-1", "build-image", {"dockerfile": "Dockerfile", "name": image}),
            1,
            ["RUN exit 7: exit code 7"],
        ),
        (Step("image-3", "build-image", {"spec": "image.yml", "name": image}, NO_DOCKER), 3, ["Docker"]),
        (Step("coverage-2", "coverage-upload", coverage | {"service": "codacy"}), 2, ["CODACY_PROJECT_TOKEN"]),
        (
            Step(
                "coverage-3",
                "coverage-upload",
                coverage | {"service": "codacy", "project-token": TOKEN, "api-url": refused},
            ),
            3,
            ["Connection refused"],
        ),
    ]
    steps = [step for step, _, _ in cases]
    run = repository.push(workflow(steps), FILES | files)
    assert outcomes(run) == {step.id: "failure" for step in steps}, run.log
    assert "Traceback" not in run.log
    assert run.installations == ["engine", "run", "coverage"]  # the second serves nearly all that follow
    for step, code, said in cases:
        came = outcome(run, step)
        assert (came.code, len(came.annotations)) == (code, 1), came.log
        [annotation] = came.annotations
        assert all(text in annotation for text in said), annotation
        expected = {1: "fail", 2: "", 3: ""} | ({3: "pass"} if step.id == "coverage-3" else {})
        assert came.outputs["verdict"] == expected[code], came.log


def test_inputs_are_data(repository: Repository) -> None:
    """Text in an input is neither shell, nor a workflow command, nor a line of an output or environment file."""
    output = {"output": f"out\nINJECTED=yes\n{HOSTILE}"}
    hostile = [
        Step("pipeline", "", {"config": HOSTILE, "only": HOSTILE, **output}),
        Step("table", "introspect-csv", {"file": HOSTILE, "column": HOSTILE, "max": "3", **output}),
        Step("matrix", "calibrate-matrix", {"dataset": HOSTILE, "evaluate": HOSTILE, **output}),
        Step("collection", "collect-data-sim", {"system": HOSTILE, "motion": HOSTILE, **output}),
        Step("image", "build-image", {"spec": HOSTILE, "name": HOSTILE, **output}),
        Step("coverage", "coverage-upload", {"run": HOSTILE, "service": "none", **output}),
        Step("python", "introspect-csv", {"file": "my table.csv", "python": HOSTILE}),
    ]
    after = 'echo "injected=[${INJECTED:-}]"; test -z "$(find "$GITHUB_WORKSPACE" -name "pwned*")"'
    run = repository.push(workflow(hostile, after), FILES)
    assert run.code == 0, run.log
    assert "injected=[]" in run.printed
    assert "Traceback" not in run.log
    for step in hostile:
        came = outcome(run, step)
        assert (came.code, len(came.annotations)) == (2, 1), came.log
        assert not any(said.startswith("::error::injected") for said in came.annotations)
        assert came.outputs["verdict"] == ""


def test_the_repositorys_own_pipeline(suite_with_robots: Path, cache: Path) -> None:
    """The job of push.yml that runs the root action, on the systems that ship."""
    run = Repository(suite_with_robots, suite_with_robots, cache).act("push", "--job", "action")
    assert run.code == 0, run.log
    assert run.installations == ["run"]
    assert run.outputs == declared("")
