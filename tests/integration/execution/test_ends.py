"""Ends of containers and jobs: each has its exit code and a message that names it."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("docker")

from docker.errors import APIError, NotFound

from calibration.base import ExitCode, InfrastructureError, InputError
from calibration.ci.execution.docker.backend import DockerBackend
from calibration.ci.execution.docker.container_run import attach
from calibration.ci.execution.docker.labels import RUN_LABEL, new_run
from calibration.ci.execution.docker.run_objects import Networks
from calibration.ci.execution.job import OUTPUT, Artifact, Container, Job, Limits, Readiness
from calibration.ci.execution.outcome import End
from tests.docker_engine import PYTHON_IMAGE, only_sleep
from tests.integration.execution.jobs import left, python, run_job, run_jobs, shell

if TYPE_CHECKING:
    from docker import DockerClient

MIB = 1024**2
EAT = "bytearray(300 * 2**20)"


@pytest.mark.parametrize(
    ("container", "end", "code", "exit_code", "reason"),
    [
        (shell("exit 0"), End.EXITED, 0, 0, None),
        (shell("exit 3", success=(0, 3)), End.EXITED, 3, 0, None),
        (shell("exit 143", success=(143,)), End.EXITED, 143, 0, None),
        (shell("exit 0", success=(3,)), End.EXITED, 0, 1, "container 'a' ended with exit code 0"),
        (
            shell("exit 0", success=()),
            End.EXITED,
            0,
            1,
            "container 'a' ended with exit code 0, before the job was done",
        ),
        (shell("echo boom >&2; exit 3"), End.EXITED, 3, 1, "container 'a' ended with exit code 3: boom"),
        (shell("kill -SEGV $$"), End.SIGNALLED, 139, 1, "container 'a' was killed by SIGSEGV"),
        (shell("kill -KILL $$"), End.SIGNALLED, 137, 1, "container 'a' was killed by SIGKILL"),
        (
            python(EAT, limits=Limits(memory=64 * MIB)),
            End.OUT_OF_MEMORY,
            137,
            1,
            "container 'a' ran out of memory: its limit is 64 MiB (memory)",
        ),
        (
            shell(f"exec 2>&1; python3 -c '{EAT}'; sleep 1; echo so what; exit 0", limits=Limits(memory=64 * MIB)),
            End.OUT_OF_MEMORY,
            0,
            1,
            "container 'a' ran out of memory: its limit is 64 MiB (memory): so what",
        ),
        (
            shell("sleep 600", limits=Limits(seconds=0.5)),
            End.TIMED_OUT,
            143,
            3,
            "container 'a' ran longer than its 0.5 s",
        ),
        (
            Container("a", PYTHON_IMAGE, ("nosuch",)),
            End.EXITED,
            127,
            1,
            "container 'a' ended with exit code 127 (its command was not found): [FATAL tini",
        ),
        (
            Container("a", PYTHON_IMAGE, ("/etc/passwd",)),
            End.EXITED,
            126,
            1,
            "container 'a' ended with exit code 126 (its command is not executable)",
        ),
        (
            shell("true", user="nosuch"),
            End.NOT_STARTED,
            None,
            2,
            "container 'a': the Docker Engine reports: unable to find user nosuch",
        ),
        (
            shell("true", limits=Limits(cpus=512)),
            End.NOT_STARTED,
            None,
            2,
            "container 'a': the Docker Engine reports: Range of CPUs is from 0.01 to",
        ),
    ],
)
def test_each_end_has_its_own_message(
    tmp_path: Path, container: Container, end: End, code: int | None, exit_code: int, reason: str | None
) -> None:
    outcome = run_job(tmp_path, container)
    [found] = outcome.containers
    assert (found.end, found.exit_code, outcome.exit_code) == (end, code, exit_code)
    assert outcome.verdict == ("pass" if exit_code == 0 else "fail")
    if reason is None:
        assert outcome.reasons == ()
    else:
        assert len(outcome.reasons) == 1
        assert outcome.reasons[0].startswith(reason)
        assert outcome.reasons[0].isprintable()
    manifest = json.loads((outcome.folder / "manifest.json").read_text())
    assert manifest["schema"] == 1
    assert manifest["verdict"] == outcome.verdict
    assert manifest["reasons"] == list(outcome.reasons)
    assert manifest["containers"][0]["end"] == end.value
    assert found.image.startswith("sha256:")


def test_a_job_ends_with_its_essential_container(tmp_path: Path) -> None:
    outcome = run_job(
        tmp_path,
        shell("echo up; sleep 600", "sim", essential=False, readiness=Readiness(log="up")),
        shell("echo done", "robot", after=("sim",)),
    )
    sim, robot = outcome.containers
    assert outcome.verdict == "pass"
    assert (sim.end, robot.end) == (End.STOPPED, End.EXITED)
    assert (outcome.folder / "logs" / "sim.log").read_text() == "up\n"
    assert (outcome.folder / "logs" / "robot.log").read_text() == "done\n"


def test_containers_that_ignore_sigterm_are_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.ci.execution.docker.job_run.STOP_SECONDS", 1)
    stubborn = python(
        "import signal, time\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\nprint('up', flush=True)\ntime.sleep(600)",
        "stubborn",
        essential=False,
        readiness=Readiness(log="up"),
    )
    outcome = run_job(tmp_path, stubborn, shell("exit 5", after=("stubborn",)))
    assert [c.exit_code for c in outcome.containers] == [137, 5]
    assert outcome.reasons == ("container 'a' ended with exit code 5",)


def test_of_two_that_fail_the_essential_one_is_the_cause(tmp_path: Path) -> None:
    outcome = run_job(
        tmp_path,
        shell(f"echo no simulator >&2; touch {OUTPUT}/ends; exit 7", "sim", essential=False),
        shell(f"until [ -e {OUTPUT}/ends ]; do sleep 0.1; done; sleep 0.7; echo nothing came >&2; exit 1", "robot"),
    )
    assert outcome.reasons == (
        "container 'robot' ended with exit code 1: nothing came",
        "container 'sim' ended with exit code 7: no simulator",
    )


def test_a_helper_that_ends_is_no_failure_by_itself(tmp_path: Path) -> None:
    outcome = run_job(tmp_path, shell("exit 7", "helper", essential=False), shell("sleep 0.5"))
    assert (outcome.verdict, outcome.reasons) == ("pass", ())


def test_the_time_of_a_job(tmp_path: Path) -> None:
    outcome = run_job(
        tmp_path,
        shell("sleep 600", "a"),
        shell("sleep 600", "b"),
        shell("x", "c", after=("d",)),
        shell("sleep 600", "d", readiness=Readiness(file="/never")),
        seconds=1.5,
    )
    assert outcome.exit_code == ExitCode.INFRASTRUCTURE
    assert outcome.reasons == (
        "the job ran longer than its 1.5 s: still running were d, a, b; not started were c",
    ) or (outcome.reasons == ("the job ran longer than its 1.5 s: still running were a, b, d; not started were c",))
    assert {c.name: c.end for c in outcome.containers} == {
        "a": End.TIMED_OUT,
        "b": End.TIMED_OUT,
        "c": End.NOT_STARTED,
        "d": End.TIMED_OUT,
    }


def test_an_essential_container_that_never_ran_is_no_success(tmp_path: Path) -> None:
    outcome = run_job(
        tmp_path,
        shell("sleep 600", "sim", essential=False, readiness=Readiness(file="/never")),
        shell("sleep 0.3", "first"),
        shell("true", "second", after=("sim",)),
    )
    assert outcome.exit_code == ExitCode.FAIL
    assert outcome.reasons == ("container 'second' was not started: another container ended the job",)


@pytest.mark.parametrize(
    ("image", "kind", "message"),
    [
        ("127.0.0.1:1/nosuch:1", InfrastructureError, "it cannot be pulled: "),
        ("UPPER case", InputError, "image 'UPPER case'"),
    ],
)
def test_a_missing_image_is_reported_before_the_start(
    tmp_path: Path, image: str, kind: type[Exception], message: str
) -> None:
    jobs = [Job("fine", (shell("true"),)), Job("wrong", (Container("a", image, ("true",)),))]
    with pytest.raises(kind) as caught:
        run_jobs(tmp_path, *jobs)
    assert message in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_an_image_that_its_registry_does_not_have(tmp_path: Path, registry: Any) -> None:
    image = f"{registry.address}/team/nosuch:1"
    with pytest.raises(InputError) as caught:
        run_job(tmp_path, Container("a", image, ("true",)))
    assert f"image '{image}': it cannot be pulled: " in str(caught.value)
    assert str(caught.value).endswith("check the name, or log in, or build it")


def test_an_image_that_only_its_registry_has_is_pulled(tmp_path: Path, registry: Any, engine: Any) -> None:
    image = f"{registry.address}/team/pulled"
    engine.api.import_image_from_data(only_sleep(), image, "1")
    for line in engine.api.push(image, "1", stream=True, decode=True):
        assert "error" not in line
    engine.api.remove_image(f"{image}:1")
    try:
        assert run_job(tmp_path, Container("a", f"{image}:1", ("/bin/sleep", "0"))).verdict == "pass"
    finally:
        engine.api.remove_image(f"{image}:1")


def test_results_of_an_earlier_run_are_not_mistaken_for_current_ones(tmp_path: Path) -> None:
    first = run_job(tmp_path, shell(f"echo 1 > {OUTPUT}/a.csv", artifacts=(Artifact(f"{OUTPUT}/*"),)))
    (first.folder / "other.csv").write_text("not ours")
    second = run_job(tmp_path, shell("exit 1", artifacts=(Artifact(f"{OUTPUT}/*"),)))
    assert (first.verdict, second.verdict) == ("pass", "fail")
    assert list((second.folder / "artifacts").iterdir()) == []
    assert (second.folder / "other.csv").exists()


def test_a_folder_that_cannot_be_made_stops_the_run(tmp_path: Path) -> None:
    (tmp_path / "job").write_text("a file")
    with pytest.raises(InfrastructureError, match="job: cannot be written: Not a directory"):
        run_job(tmp_path, shell("true"))


def test_jobs_that_make_no_sense_start_nothing(tmp_path: Path) -> None:
    with DockerBackend() as backend:
        with pytest.raises(InputError, match="no container is essential"):
            backend.run([Job("j", (shell("true", essential=False),))], tmp_path)
        with pytest.raises(InputError, match="jobs: found 0"):
            backend.run([Job("j", (shell("true"),))], tmp_path, workers=0)
        assert list(backend.run([], tmp_path)) == []


def test_an_image_that_only_others_may_pull(tmp_path: Path, private_registry: Any) -> None:
    with pytest.raises(InputError, match=r"cannot be pulled: .*(no basic auth|denied|unauthorized)"):
        run_job(tmp_path, Container("a", f"{private_registry.address}/team/robot:1", ("true",)))


def test_an_image_that_vanishes_after_it_was_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = {PYTHON_IMAGE: "sha256:" + "0" * 64}
    monkeypatch.setattr("calibration.ci.execution.docker.backend.find_images", lambda *_: found)
    outcome = run_job(tmp_path, shell("true"))
    assert outcome.exit_code == ExitCode.BAD_INPUT
    assert outcome.reasons[0].startswith("container 'a': the Docker Engine reports: No such image: sha256:000")


def test_failed_removals_are_reported(tmp_path: Path, engine: "DockerClient") -> None:
    """Another container uses a volume of the run."""
    run, volume = new_run(), f"calibration-test-{new_run()}"
    host = engine.api.create_host_config(binds={volume: {"bind": "/v", "mode": "rw"}})
    backend = DockerBackend(run=run)
    backend.__enter__()
    engine.api.create_volume(volume, labels={RUN_LABEL: run})
    user = engine.api.create_container(PYTHON_IMAGE, ["true"], host_config=host)
    with pytest.raises(InfrastructureError, match=f"cannot be removed: volume {volume}: .*in use"):
        backend.__exit__(None, None, None)
    engine.api.remove_container(user)
    with pytest.raises(ZeroDivisionError), DockerBackend(run=run):  # the first error is reported
        raise ZeroDivisionError
    assert left(engine, run) == []


def test_an_engine_without_addresses(engine: "DockerClient", monkeypatch: pytest.MonkeyPatch) -> None:
    said = "could not find an available, non-overlapping IPv4 address pool among the defaults"

    def full(*_: object, **__: object) -> None:
        raise APIError(said, explanation=said)

    monkeypatch.setattr(engine.api, "create_network", full)
    with pytest.raises(InfrastructureError, match="no addresses for one more network: run fewer jobs at once"):
        Networks("r", {}).take(engine.api, internal=False)


def test_attaching_to_a_missing_container(engine: "DockerClient") -> None:
    with pytest.raises(NotFound):
        attach(engine.api, "0" * 64)
