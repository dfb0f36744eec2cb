import hashlib
from pathlib import Path

import pytest

pytest.importorskip("docker")

from calibration.base import ExitCode
from calibration.ci.execution.job import OUTPUT, Artifact, Readiness
from tests.addons.aws_batch.integration.inside.tasks import run_task
from tests.integration.execution.jobs import shell

ALL = (Artifact(f"{OUTPUT}/*"),)


@pytest.mark.thorough
def test_artifacts_of_containers_with_any_user(tmp_path: Path) -> None:
    ran = run_task(
        tmp_path,
        shell(
            f"cd {OUTPUT}; printf 1,2 > a.csv; mkdir -m 700 d; printf x > d/b; chmod 0 d/b; ln a.csv c; ln -s a.csv l",
            "robot",
            artifacts=ALL,
            after=("sim",),
        ),
        shell(
            f"mkdir {OUTPUT}/7; echo from sim > {OUTPUT}/7/s.txt; cd {OUTPUT}; ln -s {OUTPUT}/7 latest; sleep 60",
            "sim",
            user="0",
            essential=False,
            readiness=Readiness(file=f"{OUTPUT}/latest"),
            artifacts=(Artifact(f"{OUTPUT}/latest/*.txt"), Artifact(f"{OUTPUT}/nosuch/*", required=False)),
        ),
    )
    assert ran.outcome.reasons == ()
    files = {file.path: file for file in ran.outcome.artifacts}
    assert set(files) == {"a.csv", "c", "d/b", "s.txt", "7/s.txt"}
    assert files["a.csv"].sha256 == hashlib.sha256(b"1,2").hexdigest()
    assert (files["a.csv"].container, files["s.txt"].container) == ("robot", "sim")
    assert (ran.artifacts / "c").read_bytes() == b"1,2"
    assert ran.outcome.left_out == (
        "container 'robot': 'output/l' is a link to 'a.csv'",
        f"container 'robot': 'output/latest' is a link to '{OUTPUT}/7'",
    )


def test_a_required_artifact_that_is_missing(tmp_path: Path) -> None:
    ran = run_task(tmp_path, shell(f"echo 1 > {OUTPUT}/b.txt", artifacts=(Artifact(f"{OUTPUT}/*.csv"), *ALL)))
    assert ran.outcome.reasons == (
        f"container 'a' left no file for the artifact '{OUTPUT}/*.csv'; beside it are b.txt",
    )
    assert [file.path for file in ran.outcome.artifacts] == ["b.txt"]


@pytest.mark.parametrize(
    ("leave", "message"),
    [
        ("ln -s /etc/passwd x", "artifact 'output/x' is a link to '/etc/passwd', which leaves the folder"),
        ("mkfifo x", "artifact 'output/x' is no file or folder, but a device or a pipe"),
        ("mknod x c 1 5", "artifact 'output/x' is no file or folder, but a device or a pipe"),
        ("truncate -s 10G x", "artifact 'output/x' has 10 GiB: more than the 2 GiB allowed for the artifacts"),
        ("touch $(seq 120)", "exceeds the limit of 100 artifacts of a job"),
        ('touch "$(printf "bad\\377")"', "has a name that some file systems do not allow"),
        ("d=.; for i in $(seq 70); do d=$d/d; done; mkdir -p $d; touch $d/x", "is nested in more than 64 folders"),
    ],
)
def test_unsafe_artifacts_are_refused_by_name(tmp_path: Path, leave: str, message: str) -> None:
    ran = run_task(tmp_path, shell(f"cd {OUTPUT}; touch before; {leave}", artifacts=ALL, user="0"), artifact_files=100)
    assert ran.outcome.exit_code == ExitCode.FAIL
    assert len(ran.outcome.reasons) == 1
    assert ran.outcome.reasons[0].startswith("container 'a': ")
    assert message in ran.outcome.reasons[0]
    assert ran.outcome.artifacts == ()
    assert not ran.artifacts.exists()
