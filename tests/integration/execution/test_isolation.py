"""Privileges of containers, by default and by relaxations."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calibration.ci.docker_engine import find_engine
from calibration.ci.execution.docker import backend as backend_module
from calibration.ci.execution.docker.container_run import container_settings
from calibration.ci.execution.docker.labels import RUN_LABEL, new_run
from calibration.ci.execution.docker.run_objects import Networks, find_leftovers, remove
from calibration.ci.execution.job import (
    OUTPUT,
    Artifact,
    Container,
    Job,
    Limits,
    Mount,
    Network,
    Readiness,
    Relaxations,
)
from tests.integration.execution.jobs import python, run_job, run_jobs, shell

if TYPE_CHECKING:
    from docker import DockerClient

STATUS = "grep -E 'CapBnd|NoNewPrivs' /proc/self/status | tr -s '\\t\\n' ' '; cat /proc/1/comm"


def printed(folder: Path, container: Container, network: Network = "private") -> str:
    outcome = run_job(folder, container, network=network)
    log = (outcome.folder / "logs" / "a.log").read_text()
    assert outcome.reasons == (), log
    return log


def test_safe_by_default(tmp_path: Path) -> None:
    assert printed(tmp_path, shell(STATUS, user="0")) == "CapBnd: 0000000000000000 NoNewPrivs: 1 docker-init\n"
    look = "ls /var/run/docker.sock /dev/kmsg; cat /sys/fs/cgroup/pids/pids.max /sys/fs/cgroup/pids.max; true"
    assert printed(tmp_path, shell(f"({look}) 2>/dev/null")) == "4096\n"


@pytest.mark.parametrize(
    ("relaxed", "text", "expected"),
    [
        (Relaxations(capabilities=("NET_RAW",)), STATUS, "CapBnd: 0000000000002000 NoNewPrivs: 1 docker-init\n"),
        (Relaxations(new_privileges=True), STATUS, "CapBnd: 0000000000000000 NoNewPrivs: 0 docker-init\n"),
        (Relaxations(devices=("/dev/kmsg",)), "ls /dev/kmsg", "/dev/kmsg\n"),
        (Relaxations(docker_socket=True), "test -S /var/run/docker.sock && echo there", "there\n"),
    ],
)
def test_each_relaxation_is_named(tmp_path: Path, relaxed: Relaxations, text: str, expected: str) -> None:
    assert printed(tmp_path, shell(text, user="0", relaxations=relaxed)) == expected


def test_privileged_is_everything(engine: "DockerClient") -> None:
    for privileged in (False, True):
        container = shell("true", relaxations=Relaxations(privileged=privileged))
        host = container_settings(engine.api, container, "none", "v", {}, binds=True)["host_config"]
        assert host.get("Privileged", False) == privileged
        assert ("CapDrop" in host, "SecurityOpt" in host) == (not privileged, not privileged)


def test_gpus_that_are_not_there_are_the_jobs_mistake(tmp_path: Path) -> None:
    outcome = run_job(tmp_path, shell("true", relaxations=Relaxations(gpus=True)))
    assert outcome.exit_code == 2
    assert "could not select device driver" in outcome.reasons[0]


def test_limits_hold(tmp_path: Path) -> None:
    fork = """
import subprocess
n = 0
try:
    while n < 50:
        subprocess.Popen(["sleep", "9"])
        n += 1
except OSError:
    print(n < 20)
"""
    assert printed(tmp_path, python(fork, limits=Limits(processes=16))) == "True\n"
    burn = """
import time
wall, cpu = time.monotonic(), time.process_time()
while time.monotonic() - wall < 1: pass
print(time.process_time() - cpu < 0.75)
"""
    assert printed(tmp_path, python(burn, limits=Limits(cpus=0.5))) == "True\n"


def test_settings_arrive(tmp_path: Path) -> None:
    container = Container(
        "a",
        "calibration-test:python",
        ("$0", "a b"),
        ("sh", "-c", 'pwd; id -u; echo "$0" "$1" $X; hostname'),
        {"X": "x  y"},
        working_directory="/srv/new",
        user="1234",
    )
    assert printed(tmp_path, container) == "/srv/new\n1234\n$0 a b x y\na\n"
    assert printed(tmp_path, Container("a", "calibration-test:python", ("echo", "x"), ())) == "x\n"


def test_mounts_are_read_only_by_default(tmp_path: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    (data / "in").write_text("content\n")
    data.chmod(0o777)
    mounts = (Mount(data, "/data"), Mount(data, "/writable", writable=True), Mount(data / "in", "/in/file"))
    text = (
        "cat /data/in /in/file; touch /data/x 2>/dev/null || echo refused; touch /in/file 2>/dev/null || echo refused"
    )
    assert (
        printed(tmp_path / "out", shell(f"{text}; touch /writable/y", mounts=mounts))
        == "content\ncontent\nrefused\nrefused\n"
    )
    assert sorted(path.name for path in data.iterdir()) == ["in", "y"]


def test_an_engine_that_does_not_see_our_files_gets_copies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    far = replace(find_engine(), local=False)
    monkeypatch.setattr(backend_module, "find_engine", lambda: far)
    data = tmp_path / "data"
    (data / "deep").mkdir(parents=True)
    (data / "deep" / "in").write_text("content\n")
    (data / "deep" / "in").chmod(0o600)
    (data / "run").write_text("#!/bin/sh\necho runs\n")
    (data / "run").chmod(0o700)
    text = "cat /data/deep/in /in; /data/run; test -w /data/deep/in || echo refused"
    mounts = (Mount(data, "/data"), Mount(data / "deep" / "in", "/in"))
    assert printed(tmp_path / "out", shell(text, mounts=mounts)) == "content\ncontent\nruns\nrefused\n"
    outcome = run_job(tmp_path / "out", shell("true", mounts=(Mount(data, "/data", writable=True),)))
    assert outcome.exit_code == 2
    assert outcome.reasons[0].startswith("mount '/data': the Docker Engine cannot access the files of this machine")


def test_a_file_that_cannot_be_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    far = replace(find_engine(), local=False)
    monkeypatch.setattr(backend_module, "find_engine", lambda: far)
    with tempfile.TemporaryDirectory() as gone:
        mount = Mount(Path(gone), "/data")
        vanishing = shell("true", "second", mounts=(mount,), after=("first",))
        monkeypatch.setattr("calibration.ci.execution.docker.job_run.open_output", lambda *_: Path(gone).rmdir())
        outcome = run_job(tmp_path, shell("sleep 600", "first", essential=False), vanishing)
        Path(gone).mkdir()
    assert outcome.exit_code == 2
    assert f"mount '/data': {gone}: cannot be read: No such file or directory" in outcome.reasons[0]


LISTEN = """
import socket, threading, time
server = socket.create_server(("", 9000))
udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
udp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
udp.bind(("", 9001))
group = socket.inet_aton("239.255.0.1") + socket.inet_aton("0.0.0.0")
udp.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
udp.settimeout(60)
mine = socket.gethostbyname(socket.gethostname())
open("OUTPUT/address", "w").write(mine)
def heard():
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if udp.recvfrom(9)[1][0] != mine: return True
    return False
other = None
sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
stop = threading.Event()
def send():
    while not stop.wait(0.1): sender.sendto(b"hello", ("239.255.0.1", 9001))
threading.Thread(target=send, daemon=True).start()
first, last = mine.rsplit(".", 1)
reached = []
for i in range(2, 12):
    if i != int(last):
        try: socket.create_connection((f"{first}.{i}", 9000), 0.2).close(); reached.append(i)
        except OSError: pass
print("reached", reached, "heard", heard())
""".replace("OUTPUT", OUTPUT)


def test_jobs_of_a_run_reach_each_other_by_no_means(tmp_path: Path) -> None:
    listen = LISTEN.replace("PATIENCE", "2.5")
    jobs = [Job(f"j{i}", (python(listen, artifacts=(Artifact(f"{OUTPUT}/*"),)),)) for i in range(2)]
    outcomes = run_jobs(tmp_path, *jobs, workers=2)
    logs = [(outcome.folder / "logs" / "a.log").read_text() for outcome in outcomes]
    addresses = [(outcome.folder / "artifacts" / "address").read_text() for outcome in outcomes]
    assert addresses[0] != addresses[1]
    assert logs == ["reached [] heard False\n"] * 2
    # in one job it works, so the test itself is valid
    listen = LISTEN.replace("PATIENCE", "60")
    outcome = run_job(tmp_path, python(listen, "a"), python(listen, "b", after=("a",)))
    both = "".join((outcome.folder / "logs" / f"{name}.log").read_text() for name in ("a", "b"))
    assert "heard True" in both


def test_jobs_with_several_containers_have_networks_of_their_own(tmp_path: Path) -> None:
    serve = python(
        "import http.server as h; h.test(port=8000)", "server", readiness=Readiness(port=8000), essential=False
    )
    look = """
import socket
for name in ("server", "other"):
    try:
        print(name, socket.gethostbyname(name) != "")
    except OSError:
        print(name, "unknown")
"""
    jobs = [
        Job("with", (serve, python(look, "a", after=("server",)))),
        Job("without", (shell("sleep 600", "other", essential=False), python(look))),
    ]
    found = run_jobs(tmp_path, *jobs, *(replace(job, name=f"{job.name}2") for job in jobs), workers=2)
    logs = [(outcome.folder / "logs" / "a.log").read_text() for outcome in found]
    assert logs == ["server True\nother unknown\n", "server unknown\nother True\n"] * 2


@pytest.mark.parametrize("internal", [False, True])
def test_networks_as_the_engine_makes_them(engine: "DockerClient", internal: bool) -> None:
    run = new_run()
    networks = Networks(run, {RUN_LABEL: run})
    try:
        own, shared = networks.take(engine.api, internal), networks.shared(engine.api, internal)
        assert networks.shared(engine.api, internal) == shared
        networks.give_back(shared)
        networks.give_back(own)
        assert networks.take(engine.api, internal) == own  # reused; the shared one is never taken
        other = networks.take(engine.api, internal)
        assert len({own.name, shared.name, other.name}) == 3
        found = {name: engine.api.inspect_network(name) for name in (own.name, shared.name)}
        assert [facts["Internal"] for facts in found.values()] == [internal, internal]
        assert found[shared.name]["Options"] == {"com.docker.network.bridge.enable_icc": "false"}
    finally:
        remove(engine.api, find_leftovers(engine.api, run))


def test_where_the_engine_cannot_keep_containers_apart_jobs_have_networks_of_their_own(
    engine: "DockerClient", monkeypatch: pytest.MonkeyPatch
) -> None:
    run = new_run()
    networks = Networks(run, {RUN_LABEL: run})
    monkeypatch.setattr(
        "calibration.ci.execution.docker.run_objects._NO_TALKING", {"com.docker.network.bridge.enable_icc": "perhaps"}
    )
    try:
        first = networks.shared(engine.api, False)
        second = networks.shared(engine.api, False)
        assert not first.shared
        assert first.name != second.name
    finally:
        remove(engine.api, find_leftovers(engine.api, run))


def test_no_network(tmp_path: Path) -> None:
    text = "tail -n +3 /proc/net/dev | cut -d: -f1 | tr -d ' '"
    assert printed(tmp_path, shell(text), "none") == "lo\n"
    [own] = run_jobs(tmp_path, Job("own", (shell(text),), own_network=True))
    assert "eth0" in (own.folder / "logs" / "a.log").read_text()


def test_the_machines_network_is_a_relaxation(tmp_path: Path) -> None:
    ours = Path("/proc/net/dev").read_text().count("\n")
    assert printed(tmp_path, shell("wc -l < /proc/net/dev"), "host") != "4\n" or ours == 4
