import csv
import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from calibration.errors import ExitCode, InputError, WorldError
from calibration.execution.backend import RenderedError
from calibration.execution.backends import AWS_BATCH, Place
from calibration.execution.batch.documents.job_document import TaskJob, read_job
from calibration.execution.batch.wire import JOBS_PER_FILE, Location
from calibration.execution.job import Job, Mount
from calibration.execution.kubernetes.backend import RenderingBackend
from calibration.execution.kubernetes.writing import write_rendering
from tests.aws.fixtures import BUCKET, Aws
from tests.execution.batch import client
from tests.execution.batch.samples import SETTINGS, container, job, simulation

Objects = dict[str, bytes]


def written(folder: Path, *jobs: Job, **settings: Any) -> Objects:
    write_rendering(jobs, replace(SETTINGS, **settings), "ab12", folder)
    return objects(folder)


def objects(folder: Path) -> Objects:
    """What would go to S3, by its keys."""
    root = folder / "objects"
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def tasks(folder: Path) -> list[TaskJob]:
    """The jobs as the pods of the manifests would find them, in the order of the indexes."""
    found, brought = [], objects(folder)
    for manifest in yaml.safe_load_all((folder / "jobs.yaml").read_text()):
        kubernetes_validate.validate(manifest, "1.33", strict=True)
        variables = {
            each["name"]: each.get("value", "") for each in manifest["spec"]["template"]["spec"]["containers"][0]["env"]
        }
        location = Location.parse(variables["CALIBRATION_LOCATION"])
        for child in range(manifest["spec"]["completions"]):
            index = int(variables["CALIBRATION_FIRST"]) + child
            key = location.jobs_key(index)
            found.append(read_job(brought[key], index % JOBS_PER_FILE, key))
    return found


def test_a_pod_finds_its_job_and_its_inputs(tmp_path: Path) -> None:
    (tmp_path / "in" / "data").mkdir(parents=True)
    (tmp_path / "in" / "data" / "a.csv").write_text("1,2")
    brought = written(tmp_path / "k", simulation(tmp_path / "in"))
    [task] = tasks(tmp_path / "k")
    assert [each.name for each in task.job.containers] == ["simulation", "robot"]
    assert [item.writable for item in task.inputs] == [False, True]
    for item in task.inputs:
        assert hashlib.sha256(brought[item.key]).hexdigest() == item.sha256
        assert len(brought[item.key]) == item.size
    assert client.unpacked(brought[task.inputs[0].key]) == {"a.csv": b"1,2"}
    assert len(brought) == 3


def test_every_index_has_its_job_in_files_of_a_hundred(tmp_path: Path) -> None:
    jobs = [job(container(command=("run", str(i))), name=f"w/{i}") for i in range(101)]
    jobs.insert(7, job(container(image="other"), name="other"))
    brought = written(tmp_path / "k", *jobs)
    assert len(brought) == 3
    by_shape = [*jobs[:7], *jobs[8:], jobs[7]]
    assert [task.job.name for task in tasks(tmp_path / "k")] == [each.name for each in by_shape]
    with (tmp_path / "k" / "jobs.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["job"] for row in rows] == [each.name for each in jobs]
    assert rows[8]["result"].endswith("/7/")
    assert len({row["result"] for row in rows}) == len(jobs)


def test_containers_of_a_pod_have_one_address(tmp_path: Path) -> None:
    nodes = container("a"), container("b", environment={"ROS_MASTER_URI": "http://a:11311"})
    written(tmp_path / "k", job(*nodes))
    [task] = tasks(tmp_path / "k")
    assert task.job.containers[1].environment["ROS_MASTER_URI"] == "http://127.0.0.1:11311"


def test_the_same_folder_is_sent_once(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    mounts = [(Mount(tmp_path / name, "/in"),) for name in ("one", "two")]
    brought = written(tmp_path / "k", *(job(container(mounts=m), name=str(i)) for i, m in enumerate(mounts)))
    assert sorted(key.split("/")[1] for key in brought) == ["inputs", "runs"]


def test_what_the_readme_says(tmp_path: Path) -> None:
    written(tmp_path / "k", simulation(tmp_path / "in"), prefix="team/sim")
    text = (tmp_path / "k" / "README.md").read_text()
    assert "    aws s3 sync objects s3://team-robots --region eu-west-1\n    kubectl apply -f jobs.yaml\n" in text
    assert "aws s3 sync s3://team-robots/team/sim/runs/ab12/results results --region eu-west-1" in text
    assert "the Secret `calibration` with the variables `TOKEN`" in text
    [label] = {
        manifest["metadata"]["labels"]["ci.calibration/run"]
        for manifest in yaml.safe_load_all((tmp_path / "k" / "jobs.yaml").read_text())
    }
    assert f"kubectl get jobs -l ci.calibration/run={label}" in text
    written(tmp_path / "k", job())
    assert "Secret" not in (tmp_path / "k" / "README.md").read_text()


def test_nothing_secret_is_in_any_file(tmp_path: Path) -> None:
    written(tmp_path / "k", simulation(tmp_path / "in"))
    assert not [path for path in (tmp_path / "k").rglob("*") if path.is_file() and b"s3cret" in path.read_bytes()]


def test_an_earlier_rendering_is_replaced_and_nothing_else(tmp_path: Path) -> None:
    first = written(tmp_path / "k", job(name="first"), job(container(image="x"), name="other"))
    second = written(tmp_path / "k", job(name="second"))
    assert not first.keys() & second.keys() or first != second
    assert [task.job.name for task in tasks(tmp_path / "k")] == ["second"]
    assert [path.name for path in tmp_path.iterdir()] == ["k"]
    (tmp_path / "other").mkdir()
    with pytest.raises(InputError, match="exists already, and is no earlier rendering"):
        written(tmp_path / "other", job())


@pytest.mark.parametrize(
    ("jobs", "message"),
    [
        ([job(), job()], "another job of the run has the name"),
        ([job(network="none")], "on Kubernetes a task has to reach S3"),
        ([job(container(mounts=(Mount(Path(__file__), "/f"),)))], "only folders can be mounted"),
    ],
)
def test_what_makes_no_sense_leaves_nothing(tmp_path: Path, jobs: list[Job], message: str) -> None:
    with pytest.raises(InputError, match=message):
        written(tmp_path / "k", *jobs)
    assert not list(tmp_path.iterdir())


def test_an_input_that_cannot_be_sent_leaves_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "link").symlink_to("/etc/passwd")
    with pytest.raises(InputError, match="leads out of the folder"):
        written(tmp_path / "k", job(container(mounts=(Mount(folder, "/in"),))))
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(WorldError, match="cannot be written"):
        written(tmp_path / "file" / "k", job())


def test_the_backend_writes_and_runs_nothing(tmp_path: Path) -> None:
    place = Place(AWS_BATCH, SETTINGS, "mine", render=tmp_path / "k")
    with place.open() as backend, pytest.raises(RenderedError, match="1 jobs of run mine are in") as caught:
        backend.run([job()], tmp_path / "unused")
    assert (caught.value.run, caught.value.count, caught.value.folder) == ("mine", 1, tmp_path / "k")
    assert [task.job.name for task in tasks(tmp_path / "k")] == ["j"]
    assert not (tmp_path / "unused").exists()
    assert len({RenderingBackend(SETTINGS, None, tmp_path / "k").run_name for _ in range(3)}) == 3
    with pytest.raises(InputError, match="run 'a/b': expected letters"):
        Place(AWS_BATCH, SETTINGS, "a/b", render=tmp_path / "k").open()


def test_what_a_cluster_left_is_judged_by_a_run_that_is_resumed(tmp_path: Path, batch_emulator: Aws) -> None:
    """The keys, the marks of the jobs and the outcomes are those of AWS Batch: only what is missing runs there."""
    jobs = client.jobs(3)
    write_rendering(jobs, client.SETTINGS, "k1", tmp_path / "k")
    for key, content in objects(tmp_path / "k").items():
        batch_emulator.services.put(BUCKET, key, content)
    with (tmp_path / "k" / "jobs.csv").open() as file:
        places = [row["result"] for row in csv.DictReader(file)]
    for index, task in enumerate(tasks(tmp_path / "k")[:2]):
        _leave(batch_emulator, f"calibration/runs/k1/{places[index]}1/", task)
    ran = client.Tasks(batch_emulator)
    outcomes, _ = client.run_jobs(tmp_path / "out", *jobs, run="k1", resume=True)
    assert [name for name, _ in ran.ran] == ["world/2"]
    assert [outcome.exit_code for outcome in outcomes] == [ExitCode.PASS] * 3
    assert (outcomes[1].folder / "artifacts" / "dataset" / "name").read_bytes() == b"of a pod"


def _leave(aws: Aws, place: str, task: TaskJob) -> None:
    """Put there what the watching container of a pod leaves."""
    from calibration.execution.batch.documents.outcome_document import outcome_document

    did = client.Did({"dataset/name": b"of a pod"})
    aws.services.put(BUCKET, f"{place}files/dataset/name", b"of a pod")
    aws.services.put(BUCKET, f"{place}outcome.json", outcome_document(client.outcome_of(task, 1, did)))
