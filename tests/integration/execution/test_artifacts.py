import hashlib
import json
from pathlib import Path

import pytest

from calibration.base import ExitCode
from calibration.ci.execution.job import OUTPUT, Artifact, Job, Readiness
from tests.integration.execution.jobs import run_job, run_jobs, shell

ALL = (Artifact(f"{OUTPUT}/*"),)


def test_artifacts_of_users_other_than_root(tmp_path: Path) -> None:
    outcome = run_job(
        tmp_path,
        shell(
            f"cd {OUTPUT}; printf 1,2 > a.csv; mkdir d; printf x > d/b; ln a.csv c; ln -s a.csv l",
            "robot",
            artifacts=ALL,
            after=("sim",),
        ),
        # an earlier container with another user on the same volume
        shell(
            f"id -u; echo from sim > {OUTPUT}/sim.txt; sleep 60",
            "sim",
            user="0",
            essential=False,
            readiness=Readiness(file=f"{OUTPUT}/sim.txt"),
            artifacts=(Artifact("/etc/hostname"), Artifact("/nosuch/*", required=False)),
        ),
    )
    assert outcome.reasons == ()
    files = {file.path: file for file in outcome.artifacts}
    assert set(files) == {"a.csv", "c", "d/b", "hostname", "sim.txt"}
    assert files["a.csv"].sha256 == hashlib.sha256(b"1,2").hexdigest()
    assert (files["a.csv"].container, files["hostname"].container) == ("robot", "sim")
    assert (outcome.folder / "artifacts" / "c").read_bytes() == b"1,2"
    assert outcome.left_out == ("container 'robot': 'output/l' is a link to 'a.csv'",)
    manifest = json.loads((outcome.folder / "manifest.json").read_text())
    assert manifest["left_out"] == list(outcome.left_out)
    assert {"path": "d/b", "container": "robot", "size": 1, "sha256": files["d/b"].sha256} in manifest["artifacts"]


def test_a_link_to_the_newest_folder_is_followed(tmp_path: Path) -> None:
    outcome = run_job(
        tmp_path,
        shell(
            f"cd {OUTPUT}; mkdir run-7; echo 1 > run-7/a.csv; ln -s run-7 latest",
            artifacts=(Artifact(f"{OUTPUT}/latest/*.csv"), Artifact(f"{OUTPUT}/latest")),
        ),
    )
    assert sorted(file.path for file in outcome.artifacts) == ["a.csv", "latest/a.csv"]


def test_a_required_artifact_that_is_missing(tmp_path: Path) -> None:
    outcome = run_job(
        tmp_path, shell(f"echo 1 > {OUTPUT}/b.txt", artifacts=(Artifact(f"{OUTPUT}/*.csv"), *ALL)), name="missing"
    )
    assert outcome.exit_code == ExitCode.FAIL
    assert outcome.reasons == (f"container 'a' left no file for the artifact '{OUTPUT}/*.csv'; beside it are b.txt",)
    assert [file.path for file in outcome.artifacts] == ["b.txt"]  # existing files may explain the failure
    empty = run_job(tmp_path, shell(f"mkdir {OUTPUT}/d", artifacts=(Artifact(f"{OUTPUT}/d"),)), name="empty")
    assert empty.reasons == (f"container 'a' left no file for the artifact '{OUTPUT}/d'",)


@pytest.mark.parametrize(
    ("leave", "message"),
    [
        (
            "ln -s /etc/passwd x",
            "container 'a': artifact 'output/x' is a link to '/etc/passwd', which leaves the folder",
        ),
        ("ln -s ../../../etc x", "is a link to '../../../etc', which leaves the folder"),
        ("mkfifo x", "artifact 'output/x' is no file or folder, but a device or a pipe"),
        (
            "truncate -s 10G zeros",
            "artifact 'output/zeros' has 10 GiB: more than the 2 GiB allowed for the artifacts",
        ),
        ('touch "$(printf "bad\\377")"', "has a name that some file systems do not allow"),
        ('touch "$(printf "a\\nb")"', "artifact 'output/a b' has a name that some file systems do not allow"),
        ("d=.; for i in $(seq 70); do d=$d/d; done; mkdir -p $d; touch $d/x", "is nested in more than 64 folders"),
    ],
)
def test_unsafe_artifacts_are_refused_by_name(tmp_path: Path, leave: str, message: str) -> None:
    outcome = run_job(tmp_path / "out", shell(f"cd {OUTPUT}; touch before; {leave}", artifacts=ALL))
    assert outcome.exit_code == ExitCode.FAIL
    assert len(outcome.reasons) == 1
    assert message in outcome.reasons[0]
    assert outcome.artifacts == ()
    # complete or missing, and nothing elsewhere
    assert sorted(path.name for path in outcome.folder.iterdir()) == ["logs", "manifest.json"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert outcome.seconds < 60  # without reading 10 GB


def test_limits_are_the_jobs(tmp_path: Path) -> None:
    wide = shell(f"cd {OUTPUT}; touch $(seq 20)", artifacts=ALL)
    outcome = run_job(tmp_path, wide, artifact_files=10)
    assert "exceeds the limit of 10 artifacts of a job" in outcome.reasons[0]


def test_two_artifacts_at_one_place(tmp_path: Path) -> None:
    for name, second, reasons in (
        ("same", f"echo 1 > {OUTPUT}/d/a", ()),
        (
            "other",
            f"echo 2 > {OUTPUT}/d/a",
            ("container 'a': two artifacts of the job have the same target 'a', with different content",),
        ),
        (
            "inside",
            f"mkdir {OUTPUT}/d/a; echo > {OUTPUT}/d/a/b",
            ("container 'a': the artifact 'a/b' is inside of a path that is a file of another artifact",),
        ),
    ):
        outcome = run_job(
            tmp_path,
            shell(
                f"echo 1 > {OUTPUT}/a; mkdir {OUTPUT}/d; {second}",
                artifacts=(Artifact(f"{OUTPUT}/a"), Artifact(f"{OUTPUT}/d/*")),
            ),
            name=name,
        )
        assert outcome.reasons == reasons
        assert outcome.exit_code == (ExitCode.BAD_INPUT if reasons else ExitCode.PASS)


def test_four_branches_that_end_in_the_same_second_keep_four_tables(tmp_path: Path) -> None:
    jobs = [
        Job(f"t2rgb/tn{t}_rn{r}", (shell(f"sleep 0.3; echo {t},{r} > {OUTPUT}/results.csv", artifacts=ALL),))
        for t in (0, 0.5)
        for r in (0, 0.5)
    ]
    outcomes = run_jobs(tmp_path, *jobs, workers=4)
    assert all(outcome.verdict == "pass" for outcome in outcomes)
    assert [(outcome.folder / "artifacts" / "results.csv").read_text() for outcome in outcomes] == [
        "0,0\n",
        "0,0.5\n",
        "0.5,0\n",
        "0.5,0.5\n",
    ]
