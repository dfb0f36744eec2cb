"""Commands with containers on AWS Batch: their messages, the name of the run, and resuming it."""

import json
import shutil
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.addons.aws_batch.wire import TaskJob
from calibration.base import InputError
from calibration.ci.workflow import Runner
from calibration.commands.target import RUN_FILE, execution_target, name_of_run
from tests.addons.aws_batch.client import Did, Tasks
from tests.addons.aws_batch.conftest import quick
from tests.addons.aws_batch.emulator.attempt import Attempt
from tests.addons.aws_batch.fixtures import BUCKET, QUEUE, REGION, Aws

__all__ = ["quick"]

T2RGB = Path(__file__).parents[3] / "datasets" / "t2rgb"
ROLE = "arn:aws:iam::123456789012:role/robots"
SECTION = (
    f"aws-batch: {{region: {REGION}, queue: '${{TEST_QUEUE}}', bucket: {BUCKET}, tools-image: 'team/tools:1', "
    f"job-role: '{ROLE}', execution-role: '{ROLE}'}}\n"
)
TABLE = b"Collection #,RMS (pix)\n000,0.5\nAverages,0.5\n"
SOFTWARE = (
    "--image",
    "team/robot:1",
    "--command",
    "calibrate {start} {output} {translation_noise}",
    "--calibrated",
    "none",
)


@pytest.fixture(autouse=True)
def somewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TEST_QUEUE", QUEUE)
    for variable in ("GITHUB_ACTIONS", "GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY"):
        monkeypatch.delenv(variable, raising=False)


def calibrates(task: TaskJob, attempt: Attempt) -> Did:
    """Leave a table; the noisier one of two cells fails."""
    noise = task.job.containers[0].command[-1]
    assert len(task.inputs) == 2  # the dataset, and the dataset with the noisy start
    return Did({"table.csv": TABLE.replace(b"0.5", noise.encode())})


@pytest.mark.usefixtures("quick")
def test_the_matrix_in_the_cloud(batch_emulator: Aws, capsys: pytest.CaptureFixture[str]) -> None:
    tasks = Tasks(batch_emulator, calibrates)
    Path("calibration.yml").write_text(SECTION)
    words = ["calibrate-matrix", "--dataset", str(T2RGB), *SOFTWARE, "--translation-noise", "0.1,0.2"]
    assert main([*words, "--backend", "aws-batch"]) == 0, capsys.readouterr().err
    out = capsys.readouterr().out
    document = json.loads(Path("output/results.json").read_text())
    assert [cell["rms_px"] for cell in document["cells"]] == [0.1, 0.2]
    assert {cell["method"] for cell in document["comparisons"]} == {"calibration-ci"}
    assert len(tasks.ran) == 2
    name = Path("output", RUN_FILE).read_text().strip()
    assert f"run {name} on AWS Batch, queue {QUEUE}; with --run-name {name} --resume only what is missing is run" in out

    assert main([*words, "--backend", "aws-batch", "--resume"]) == 0  # the name is saved in the output folder
    assert main([*words, "--backend", "aws-batch", "--resume", "--run", name, "--output", "elsewhere"]) == 0
    assert len(tasks.ran) == 2
    assert main([*words, "--backend", "aws-batch", "--run", "other"]) == 0
    assert len(tasks.ran) == 4
    assert Path("output", RUN_FILE).read_text() == "other\n"


@pytest.mark.thorough
@pytest.mark.usefixtures("quick")
def test_a_pipeline_in_the_cloud(batch_emulator: Aws, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(T2RGB, tmp_path / "collected")
    for name in ("ground_truth.json", "motion.json"):
        (tmp_path / "collected" / name).unlink()
    dataset = {f"dataset/{path.name}": path.read_bytes() for path in (tmp_path / "collected").iterdir()}

    def both(task: TaskJob, attempt: Attempt) -> Did:
        return Did(dataset) if task.job.name == "collection" else calibrates(task, attempt)

    tasks = Tasks(batch_emulator, both)
    Path("calibration.yml").write_text(
        f"{SECTION}backend: aws-batch\n"
        "systems:\n"
        f"  t2rgb: {{dataset: {T2RGB}, software: "
        "{image: i, command: 'run {seed} {translation_noise}', calibrated: none}}\n"
        "simulation:\n"
        f"  fresh: {{system: {T2RGB}, containers: {{robot: {{image: i, command: 'collect {{scenario}}'}}}}}}\n"
    )
    assert main(["run"]) == 0, capsys.readouterr().out
    assert sorted(name for name, _ in tasks.ran) == ["collection", "t2rgb/translation-0_rotation-0_seed-1"]
    document = json.loads(Path("output/results.json").read_text())
    assert [each["verdict"] for each in document["collections"]] == ["pass"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((*SOFTWARE, "--backend", "aws-batch"), "calibration.yml: a file with a section aws-batch was expected"),
        ((*SOFTWARE, "--backend", "embedded"), "backend: found 'embedded', expected docker or aws-batch"),
        (("--backend", "aws-batch"), "backend: found aws-batch, which runs the team's own software"),
        ((*SOFTWARE, "--resume"), "resume: is for the backend aws-batch"),
        (("--run", "mine"), "run-name: is for the backend aws-batch"),
        (
            (*SOFTWARE, "--backend", "aws-batch", "--registry-username", "me"),
            "registry-username: aws-batch pulls with its execution role",
        ),
        ((*SOFTWARE, "--backend", "aws-batch", "--aws-batch", "no.yml"), "no.yml: a file with a section aws-batch"),
        (
            (*SOFTWARE, "--backend", "aws-batch", "--aws-batch", "cloud.yml", "--resume"),
            "resume: there is no output/run.txt, which names the earlier run; give its name (run)",
        ),
    ],
)
def test_bad_input_is_one_line(words: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("cloud.yml").write_text(SECTION)
    assert main(["calibrate-matrix", "--dataset", str(T2RGB), *words]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert len(err.splitlines()) == 1
    assert not Path("output").exists()


def test_a_section_that_has_been_read_counts_unless_a_file_is_given(tmp_path: Path) -> None:
    Path("cloud.yml").write_text(SECTION)
    runner = Runner.from_environment({})
    given = execution_target("aws-batch", Path("cloud.yml"), tmp_path, "r", False, runner).sections
    assert given.of("aws-batch") is not None
    assert given.of("aws-batch").queue == QUEUE
    assert execution_target("aws-batch", None, tmp_path, "r", False, runner, given).sections is given
    Path("cloud.yml").write_text(SECTION.replace("${TEST_QUEUE}", "another"))
    changed = execution_target("aws-batch", Path("cloud.yml"), tmp_path, "r", True, runner, given)
    assert changed.settings is not None
    assert (changed.settings.queue, changed.run, changed.resume) == ("another", "r", True)
    on_docker = execution_target("docker", Path("no.yml"), tmp_path, "r", True, runner)
    assert (on_docker.backend, on_docker.settings, on_docker.run) == ("docker", None, "r")


@pytest.mark.parametrize("text", ["aws-batch: 3", "[]", "other: 1"])
def test_a_file_without_the_section(text: str, tmp_path: Path) -> None:
    Path("cloud.yml").write_text(text)
    with pytest.raises(InputError, match=r"cloud\.yml: .*region"):
        execution_target("aws-batch", Path("cloud.yml"), tmp_path, "r", False, Runner.from_environment({}))
    assert not (tmp_path / RUN_FILE).exists()


def test_the_name_of_a_run(tmp_path: Path) -> None:
    new = name_of_run(tmp_path / "out", None, False)
    assert name_of_run(tmp_path / "out", None, True) == new
    assert name_of_run(tmp_path / "out", None, False) != new
    assert name_of_run(tmp_path / "out", "mine", True) == "mine"
    assert name_of_run(tmp_path / "out", None, True) == "mine"
