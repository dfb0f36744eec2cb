"""Our player and a real ROS 1 system: a master and nodes in a container."""

import io
import json
import tarfile
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from calibration.robot.simulation.motion import PLAYER_FILE
from tests.docker_engine import wait_until

if TYPE_CHECKING:
    from docker import DockerClient
    from docker.models.containers import Container

DOCKERFILE = """FROM {base}
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends \
    python3-rospy python3-roslaunch python3-geometry-msgs python3-std-srvs && rm -rf /var/lib/apt/lists/*
RUN useradd --create-home robot
USER robot
"""
POSES = [
    (0.25, -1.5, 2.0, 0.5, -0.5, 0.5, -0.5),
    (1.0, 2.0, -3.0, 0.0, 0.0, 0.0, 1.0),
    (7.0, 8.0, 9.0, 0.0, 0.0, 0.6, 0.8),
]
HOME = "/home/robot"
SYSTEM = "python3 system.py > {node}.log 2>&1"


@pytest.fixture(scope="module")
def ros(engine: "DockerClient", base_image: str) -> "Iterator[Container]":
    """A container with a master and the node of `player_system.py`."""
    image, _ = engine.images.build(
        fileobj=io.BytesIO(DOCKERFILE.format(base=base_image).encode()), tag="calibration-test:ros1", forcerm=True
    )
    container = engine.containers.run(
        image.id,
        ["roscore"],
        detach=True,
        init=True,
        cap_drop=["ALL"],
        security_opt=["no-new-privileges"],
        name=f"calibration-test-player-{uuid.uuid4().hex[:12]}",
        environment={"ROS_MASTER_URI": "http://127.0.0.1:11311", "ROS_IP": "127.0.0.1", "PYTHONUNBUFFERED": "1"},
        network_mode="none",
    )
    try:
        motion = {
            str(number + 1): {
                "position": dict(zip("xyz", pose[:3], strict=True)),
                "orientation": dict(zip("xyzw", pose[3:], strict=True)),
            }
            for number, pose in enumerate(POSES)
        }
        put(container, "player.py", PLAYER_FILE.read_bytes())
        put(container, "system.py", Path(__file__).with_name("player_system.py").read_bytes())
        put(container, "motion.json", json.dumps(motion).encode())
        wait_until(lambda: b"started core service" in container.logs(), "a master")
        start(container, "system")
        yield container
    finally:
        container.remove(force=True, v=True)


def put(container: "Container", name: str, content: bytes) -> None:
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        info = tarfile.TarInfo(name)
        info.size, info.mode = len(content), 0o644
        tar.addfile(info, io.BytesIO(content))
    assert container.put_archive(HOME, archive.getvalue())


def start(container: "Container", node: str) -> None:
    container.exec_run(["sh", "-c", SYSTEM.format(node=node)], workdir=HOME, detach=True, environment={"NODE": node})
    log = f"{HOME}/{node}.log"
    wait_until(lambda: b"ready" in container.exec_run(["cat", log]).output, f"the node {node}")


def play(container: "Container", service: str, *more: str, **settings: Any) -> tuple[int, list[str], list[str]]:
    """Exit code, and the lines of both streams."""
    fixed = ["--motion", "motion.json", "--settle", "0.2", "--service", service]
    found = container.exec_run(["python3", "player.py", *fixed, *more], workdir=HOME, demux=True, **settings)
    out, err = ((stream or b"").decode().splitlines() for stream in found.output)
    return found.exit_code, out, err


@pytest.mark.thorough
def test_every_pose_arrives_before_it_is_saved(ros: "Container") -> None:
    code, out, err = play(ros, "/save", "--frame", "stage", "--report", "report.json")
    assert (code, err) == (0, [])
    expected = [f"stage {' '.join(map(str, pose))}" for pose in POSES]
    verdicts = ["saved", "not saved", "saved"]
    for number, (line, verdict, answer) in enumerate(zip(out, verdicts, expected, strict=False)):
        assert line.startswith(f"pose {number + 1}/3: {verdict}: {answer} (")
    assert out[3].startswith("2 of 3 poses saved in ")
    report = json.loads(ros.exec_run(["cat", f"{HOME}/report.json"]).output)
    assert [entry["answer"] for entry in report] == expected
    assert [entry["saved"] for entry in report] == [True, False, True]


def test_any_service_with_an_empty_request_will_do(ros: "Container") -> None:
    code, out, err = play(ros, "/empty")
    assert (code, err) == (0, [])
    assert out[-1].startswith("3 of 3 poses saved")


@pytest.mark.parametrize(
    ("service", "more", "error"),
    [
        ("/refuse", [], "player: none of the 3 poses was saved"),
        ("/fail", [], "player: /fail failed: service [/fail] responded with an error: "),
        ("/hang", ["--timeout", "2"], "player: /hang did not answer within 2 s"),
        ("/wants", [], "player: /wants is a std_srvs/SetBool and wants data; expected one with an empty request"),
        ("/nowhere", ["--timeout", "2"], "player: no service /nowhere within 2 s"),
        ("/save", ["--timeout", "2", "--pose-topic", "/other"], "player: nobody listens to /other within 2 s"),
    ],
)
def test_what_does_not_work_is_said_in_one_line(ros: "Container", service: str, more: list[str], error: str) -> None:
    code, _, err = play(ros, service, *more)
    assert code == 1
    assert err[-1].startswith(error)
    assert "Traceback" not in "\n".join(err)


def test_without_a_master_it_says_so(ros: "Container") -> None:
    code, out, err = play(ros, "/save", "--timeout", "0.5", environment={"ROS_MASTER_URI": "http://127.0.0.1:9"})
    assert (code, out) == (1, [])
    assert err == ["player: no ROS master answers at http://127.0.0.1:9 within 0.5 s"]


def test_a_robot_that_dies_is_a_failure(ros: "Container") -> None:
    start(ros, "mortal")
    code, out, err = play(ros, "/end", "--timeout", "60")
    assert (code, out) == (1, [])
    assert err[-1].startswith("player: /end failed: ")


def test_a_simulation_that_dies_is_a_failure(ros: "Container") -> None:
    """It is seen when the next pose is published: on a busy machine the node takes a while to die of the first."""
    start(ros, "mortal")
    code, _, err = play(ros, "/empty", "--pose-topic", "/mortal/pose", "--timeout", "60", "--settle", "2")
    assert code == 1
    assert err[-1] == "player: nobody listens to /mortal/pose any more: the simulation has ended"


PLAYS = """
import rosgraph, time
while not any("/calibration_player" in str(nodes) for _, nodes in rosgraph.Master("/test").getSystemState()[0]):
    time.sleep(0.05)
"""


@pytest.mark.parametrize("name", ["TERM", "INT"])
@pytest.mark.parametrize(("settle", "service"), [("60", "/save"), ("0", "/hang")])
def test_a_signal_ends_it(ros: "Container", name: str, settle: str, service: str) -> None:
    """While it begins, waits, or calls. Not from a shell: what that starts in the background hears no INT."""
    player = f"python3 player.py --motion motion.json --settle {settle} --service {service}"
    started = (
        f"import signal, subprocess as s; signal.signal(2, signal.default_int_handler); p = s.Popen('{player}'.split())"
    )
    command = f"{started}\n{PLAYS}\np.send_signal(signal.SIG{name})\nraise SystemExit(p.wait(60))"
    found = ros.exec_run(["python3", "-c", command], workdir=HOME, demux=True)
    assert found.exit_code == 1
    assert found.output[1] == f"player: stopped by SIG{name} before the motion was played\n".encode()
