"""Our two containers, with S3: downloads, uploads, and errors."""

import hashlib
import io
import os
import shutil
import signal
import subprocess
import sys
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("boto3")

from calibration.addons.aws_batch.inside.__main__ import ContainerTask, Places, main, send_files
from calibration.addons.aws_batch.inside.script import Signs, script_of
from calibration.addons.aws_batch.wire import Input, Location, TaskOutcome, job_entry, jobs_document, read_outcome
from calibration.base import ExitCode, InfrastructureError
from calibration.ci.execution.extraction import RefusedError
from calibration.ci.execution.job import OUTPUT, Artifact, Container, Job
from calibration.ci.execution.outcome import ArtifactFile, End
from tests.addons.aws_batch.fixtures import BUCKET
from tests.docker_engine import wait_until

if TYPE_CHECKING:
    from tests.addons.aws_batch.fixtures import Aws

_LARGE = 8 * 1024**2
"""Bytes; larger files are uploaded to S3 in parts."""
LOCATION = Location(BUCKET, "team/robots", "run-1", "0a")
JOB = Job("set/103", (Container("a", "", ("sh", "-c", "exit 3")),))


@pytest.fixture
def places(tmp_path: Path) -> Places:
    found = Places(tmp_path / "job", tmp_path / "mounts", tmp_path / "output")
    for folder in (found.job, found.mounts / "0", found.output):
        folder.mkdir(parents=True)
    return found


@pytest.fixture
def aws(batch_emulator: "Aws") -> "Aws":
    return batch_emulator


def variables(**changes: str) -> dict[str, str]:
    given = {
        "CALIBRATION_LOCATION": LOCATION.text,
        "CALIBRATION_FIRST": "100",
        "AWS_BATCH_JOB_ARRAY_INDEX": "3",
        "AWS_BATCH_JOB_ATTEMPT": "2",
        "AWS_REGION": "eu-west-1",
    }
    return {**given, **changes}


def put_job(aws: "Aws", job: Job = JOB, inputs: tuple[Input, ...] = ()) -> None:
    """Upload a job as 103, the fourth in the second file."""
    entries = [job_entry(replace(JOB, name=f"x{number}"), ()) for number in range(3)]
    aws.services.put(BUCKET, LOCATION.jobs_key(103), jobs_document([*entries, job_entry(job, inputs)]))


def outcome(aws: "Aws", job: Job = JOB) -> TaskOutcome:
    key = LOCATION.result_key(103, 2, "outcome.json")
    return read_outcome(aws.services.get(BUCKET, key), job, 2, key)


def packed(*entries: tuple[str, bytes, int], kind: bytes = tarfile.REGTYPE, link: str = "") -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as archive:
        for name, content, mode in entries:
            entry = tarfile.TarInfo(name)
            entry.mode, entry.size = mode, len(content)
            entry.type = tarfile.DIRTYPE if name.endswith("/") else tarfile.SYMTYPE if link else kind
            entry.linkname = link
            archive.addfile(entry, io.BytesIO(content))
    return file.getvalue()


def put_input(aws: "Aws", data: bytes, **changes: Any) -> Input:
    digest = hashlib.sha256(data).hexdigest()
    item = Input(0, LOCATION.input_key(digest), digest, len(data))
    aws.services.put(BUCKET, item.key, data)
    return replace(item, **changes)


def test_volumes_and_scripts_of_a_prepared_job(aws: "Aws", places: Places) -> None:
    data = packed(("d/", b"", 0o755), ("d/a.csv", b"1,2", 0o644), ("run", b"#!/bin/sh", 0o755))
    put_job(aws, inputs=(put_input(aws, data),))
    assert main(["prepare"], variables(), places) == 0
    assert (places.mounts / "0" / "d" / "a.csv").read_bytes() == b"1,2"
    assert (places.mounts / "0" / "d" / "a.csv").stat().st_mode & 0o777 == 0o644
    assert (places.mounts / "0" / "run").stat().st_mode & 0o777 == 0o755
    assert (places.job / "a.sh").read_text() == script_of(JOB.containers[0], JOB)
    assert (places.job / "a.sh").stat().st_mode & 0o777 == 0o644
    assert (places.job / "state" / "a").is_dir()
    assert places.output.stat().st_mode & 0o7777 == 0o1777
    assert not aws.services.keys(BUCKET, LOCATION.result_key(103, 2))


def test_links_inside_stay_links(aws: "Aws", places: Places) -> None:
    put_job(aws, inputs=(put_input(aws, packed(("d/l", b"", 0o777), link="../a")),))
    assert main(["prepare"], variables(), places) == 0
    assert (places.mounts / "0" / "d" / "l").readlink() == Path("../a")


def test_writable_volumes_are_writable_for_all_users(aws: "Aws", places: Places) -> None:
    data = packed(("d/", b"", 0o755), ("d/a", b"1", 0o644), ("run", b"2", 0o755))
    put_job(aws, inputs=(put_input(aws, data, writable=True),))
    (places.mounts / "0" / "link").symlink_to("/etc/hostname")
    before = Path("/etc/hostname").stat().st_mode
    assert main(["prepare"], variables(), places) == 0
    modes = {name: (places.mounts / "0" / name).stat().st_mode & 0o777 for name in (".", "d", "d/a", "run")}
    assert modes == {".": 0o777, "d": 0o777, "d/a": 0o666, "run": 0o777}
    assert Path("/etc/hostname").stat().st_mode == before


@pytest.mark.thorough(but_first=3)
@pytest.mark.parametrize(
    ("data", "changes", "message"),
    [
        (packed(("a", b"1", 0o644)), {"sha256": "0" * 64}, "it is missing or changed: run the job again"),
        (packed(("a", b"1", 0o644)), {"size": 5}, "it is missing or changed: run the job again"),
        (packed(("a", b"1", 0o644)), {"key": "other"}, "it is missing or changed: run the job again"),
        (b"no tar", {}, "cannot be unpacked: "),
        (packed(("../a", b"1", 0o644)), {}, "cannot be unpacked: artifact '../a' leaves its folder"),
        (packed(("a", b"", 0o644), kind=tarfile.CHRTYPE), {}, "cannot be unpacked: 'a' is no file, folder or link"),
        (packed(("a", b"", 0o644), kind=tarfile.LNKTYPE), {}, "cannot be unpacked: 'a' is no file, folder or link"),
        (packed(("d/a", b"", 0o644), link="../../x"), {}, "'d/a' is a link to '../../x', which leaves the folder"),
        (packed(("d/a", b"", 0o644), link="/etc"), {}, "'d/a' is a link to '/etc', which leaves the folder"),
    ],
)
def test_an_input_with_another_digest(
    aws: "Aws", places: Places, capsys: pytest.CaptureFixture[str], data: bytes, changes: dict[str, Any], message: str
) -> None:
    put_job(aws, inputs=(put_input(aws, data, **changes),))
    assert main(["prepare"], variables(), places) == ExitCode.INFRASTRUCTURE
    said = capsys.readouterr().err
    assert said.startswith("error: volume 0: s3 object ")
    assert message in said
    assert said.count("\n") == 1
    found = outcome(aws)  # the client reads it
    assert found.exit_code == ExitCode.INFRASTRUCTURE
    assert f"error: {found.reasons[0]}\n" == said
    assert [c.end for c in found.containers] == [End.NOT_STARTED]
    assert not (places.job / "a.sh").exists()


def test_an_outcome_that_cannot_be_uploaded_is_logged(
    aws: "Aws", places: Places, capsys: pytest.CaptureFixture[str]
) -> None:
    put_job(aws, replace(JOB, containers=(Container("a", ""),)))
    aws.services.faults.deny("s3:PUT")
    assert main(["prepare"], variables(), places) == ExitCode.BAD_INPUT
    assert "container 'a': on AWS Batch a container needs a command" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "given", "code", "message"),
    [
        ([], variables(), 2, "expected prepare or watch"),
        (["other"], variables(), 2, "expected prepare or watch"),
        (["watch"], {}, 2, "the variables of the task are not those of a job: 'CALIBRATION_LOCATION'"),
        (["watch"], variables(CALIBRATION_FIRST="x"), 2, "the variables of the task are not those of a job: invalid"),
        (["watch"], variables(CALIBRATION_LOCATION="s3://b/c"), 2, "the variables of the task are not those of a job"),
        (["prepare"], variables(), 3, "jobs/0a/00001.json: there is no such object"),
    ],
)
def test_invalid_variables_of_a_task(
    aws: "Aws",
    places: Places,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    given: dict[str, str],
    code: int,
    message: str,
) -> None:
    assert main(arguments, given, places) == code
    assert message in capsys.readouterr().err


def test_without_an_array_it_is_the_first_of_the_group() -> None:
    task = ContainerTask(
        {"CALIBRATION_LOCATION": LOCATION.text, "CALIBRATION_FIRST": "7", "AWS_DEFAULT_REGION": "eu-west-1"}
    )
    assert (task.index, task.attempt, task.aws.region) == (7, 1, "eu-west-1")


def in_a_process(job: Job, places: Places) -> "subprocess.Popen[bytes]":
    """Run the script of a job's only container, as prepared here."""
    script = script_of(job.containers[0], job, str(places.job))
    return subprocess.Popen(["sh", "-c", script.replace(OUTPUT, str(places.output))], start_new_session=True)


def watched(aws: "Aws", places: Places, job: Job, **changes: str) -> int:
    """Prepare and supervise a job of one container; return the exit code."""
    put_job(aws, job)
    assert main(["prepare"], variables(), places) == 0
    process = in_a_process(job, places)
    try:
        return main(["watch"], variables(**changes), places)
    finally:
        process.wait(60)


LEAVES = replace(
    JOB,
    containers=(
        Container(
            "a",
            "",
            ("sh", "-c", f"cd {OUTPUT}; mkdir d; printf 1 > 'd/ö x'; head -c {_LARGE + 5} /dev/zero > large; exit 3"),
            success=(3,),
            artifacts=(Artifact(f"{OUTPUT}/*"),),
        ),
    ),
)


def test_watched_is_sent_and_the_outcome_last(aws: "Aws", places: Places) -> None:
    aws.services.faults.refuse("s3:PUT", 503, "SlowDown", "Reduce your request rate.", times=2)
    assert watched(aws, places, LEAVES) == 0
    found = outcome(aws, LEAVES)
    assert (found.reasons, found.exit_code, found.attempt) == ((), ExitCode.PASS, 2)
    assert {file.path: file.size for file in found.artifacts} == {"d/ö x": 1, "large": _LARGE + 5}
    for file in found.artifacts:
        content = aws.services.get(BUCKET, LOCATION.result_key(103, 2, f"files/{file.path}"))
        assert hashlib.sha256(content).hexdigest() == file.sha256
    assert len(aws.services.keys(BUCKET, LOCATION.result_key(103, 2))) == 3


def test_a_failed_job_is_a_task_that_did_its_work(aws: "Aws", places: Places) -> None:
    assert watched(aws, places, JOB) == 0
    assert outcome(aws).reasons == ("container 'a' ended with exit code 3",)


def test_failed_uploads_are_reported(aws: "Aws", places: Places) -> None:
    aws.services.faults.refuse("s3:PUT", 403, "AccessDenied", "no", times=100, match="files/")
    aws.services.faults.refuse("s3:POST", 403, "AccessDenied", "no", times=100, match="files/")
    assert watched(aws, places, LEAVES) == 0
    found = outcome(aws, LEAVES)
    assert found.exit_code == ExitCode.BAD_INPUT
    assert "AWS: s3:PutObject: AccessDenied" in found.reasons[0]
    assert found.artifacts == ()


def test_an_outcome_that_cannot_be_sent(aws: "Aws", places: Places, capsys: pytest.CaptureFixture[str]) -> None:
    aws.services.faults.deny("s3:PUT")
    assert watched(aws, places, JOB) == ExitCode.BAD_INPUT
    assert "AWS: s3:PutObject: AccessDeniedException" in capsys.readouterr().err
    assert not aws.services.keys(BUCKET, LOCATION.result_key(103, 2))


def test_a_longer_name_than_s3_takes(aws: "Aws") -> None:
    path = "/".join(["d" * 200] * 6)
    task = ContainerTask(variables())
    with pytest.raises(RefusedError, match="has a longer name than S3 allows"):
        send_files(task.store, [ArtifactFile(path, "a", 1, "")], Path("/nonexistent"), "p/files")


def test_a_file_that_is_not_there_any_more(aws: "Aws", tmp_path: Path) -> None:
    with pytest.raises(InfrastructureError, match="cannot be read: No such file"):
        send_files(ContainerTask(variables()).store, [ArtifactFile("gone", "a", 1, "")], tmp_path, "p/files")


def test_stopped_it_asks_the_containers_to_end_and_leaves_no_outcome(
    aws: "Aws", places: Places, tmp_path: Path
) -> None:
    job = replace(
        JOB, containers=(Container("a", "", ("sh", "-c", "echo > up; sleep 600"), working_directory=str(tmp_path)),)
    )
    put_job(aws, job)
    assert main(["prepare"], variables(), places) == 0
    process = in_a_process(job, places)
    program = (
        "import pathlib, sys, os\n"
        "from calibration.addons.aws_batch.inside.__main__ import Places, main\n"
        "places = Places(*map(pathlib.Path, sys.argv[1:]))\n"
        "sys.exit(main(['watch'], os.environ, places))\n"
    )
    command = [sys.executable, "-c", program, str(places.job), str(places.mounts), str(places.output)]
    with subprocess.Popen(command, env={**os.environ, **variables()}, stderr=subprocess.PIPE, text=True) as watching:
        wait_until((tmp_path / "up").exists, "the command runs")
        watching.send_signal(signal.SIGTERM)
        assert watching.communicate(timeout=60)[1] == "stopped\n"
        assert watching.returncode == 143
    assert process.wait(60) == 143
    assert Signs(places.job).ended("a") == (143, False)
    assert not aws.services.keys(BUCKET, LOCATION.result_key(103, 2))


def test_unwritable_volumes(aws: "Aws", places: Places, capsys: pytest.CaptureFixture[str]) -> None:
    put_job(aws)
    shutil.rmtree(places.output)
    assert main(["prepare"], variables(), places) == ExitCode.INFRASTRUCTURE
    assert f"{places.output}: cannot be written: No such file or directory" in capsys.readouterr().err
