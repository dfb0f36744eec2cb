from contextlib import suppress
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.base.records import flat_fields, read
from calibration.base.records.schema import schema_of
from calibration.ci.execution.job import Artifact, Container, Limits, Mount, Readiness, Relaxations, with_secrets

FOLDER = Path("/team")
KEYS = set(flat_fields(Container))


def container_from(entry: dict[str, Any], environment: dict[str, str]) -> Container:
    container = read(Container, entry, "here", FOLDER, name="robot")
    return with_secrets(container, "here", environment)


def test_every_key() -> None:
    entry = {
        "image": "team/robot:1",
        "command": "rosrun robot calibrate --seed {seed}",
        "entrypoint": [],
        "environment": {"A": 1, "B": True, "C": "x y", "D": 0.5},
        "secrets": ["TOKEN"],
        "working-directory": "/w",
        "user": 1000,
        "mounts": ["data:/data", "/abs:/abs:ro", {"source": "cache", "target": "/cache", "writable": True}],
        "memory": "2g",
        "cpus": 1.5,
        "processes": 100,
        "timeout": "5m",
        "ready": {"port": 80, "log": "up", "file": "/up", "command": ["test", "-e", "/x"], "timeout": 5},
        "after": ["sim"],
        "essential": False,
        "success": [0, 3],
        "artifacts": ["{output}/*.csv", {"path": "/log", "required": False}],
        "new-privileges": True,
        "capabilities": ["NET_RAW"],
        "devices": ["/dev/video0"],
        "gpus": True,
        "docker-socket": True,
        "privileged": True,
    }
    assert set(entry) == KEYS
    container = container_from(entry, {"TOKEN": "s3cret"})
    assert container == Container(
        name="robot",
        image="team/robot:1",
        command=("rosrun", "robot", "calibrate", "--seed", "{seed}"),
        entrypoint=(),
        environment={"A": "1", "B": "true", "C": "x y", "D": "0.5", "TOKEN": "s3cret"},
        secrets=frozenset({"TOKEN"}),
        working_directory="/w",
        user="1000",
        mounts=(Mount(FOLDER / "data", "/data"), Mount(Path("/abs"), "/abs"), Mount(FOLDER / "cache", "/cache", True)),
        limits=Limits(2 * 1024**3, 1.5, 100, 300),
        readiness=Readiness(80, "up", "/up", ("test", "-e", "/x"), 5),
        after=("sim",),
        essential=False,
        success=(0, 3),
        artifacts=(Artifact("{output}/*.csv"), Artifact("/log", required=False)),
        relaxations=Relaxations(True, ("NET_RAW",), ("/dev/video0",), True, True, True),
    )
    assert "s3cret" not in repr(container)


def test_everything_is_forbidden_by_default() -> None:
    assert container_from({"image": ""}, {}) == Container("robot", "")


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"comand": "x"}, "here: unknown key 'comand': did you mean 'command'?"),
        ({"command": []}, "here: command"),
        ({"command": "a 'b"}, "here: command: 'a 'b' cannot be split"),
        ({"command": ["a", 1]}, "here: command"),
        ({"memory": "much"}, "here: memory: found 'much'"),
        ({"timeout": "soon"}, "here: timeout: found 'soon'"),
        ({"ready": {"port": 80, "timeout": "x"}}, "here: ready.timeout"),
        ({"ready": {}}, "here: ready"),
        ({"mounts": ["data"]}, "here: mounts.0"),
        ({"mounts": ["data:/data:rw"]}, "here: mounts.0"),
        ({"mounts": [{"source": "a"}]}, "here: mounts.0"),
        ({"secrets": ["NOT_SET"]}, "here.secrets: the environment variable NOT_SET is not set"),
        ({"secrets": ["TOKEN"], "environment": {"TOKEN": "x"}}, "TOKEN is in environment and in secrets"),
        ({"capabilities": ["net_raw"]}, "here: capabilities.0"),
        ({"success": 256}, "here: success"),
        ({"artifacts": [3]}, "here: artifacts.0"),
    ],
)
def test_errors_name_the_key(entry: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        container_from(entry, {"TOKEN": "x"})
    assert message in str(caught.value)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


@given(st.dictionaries(st.sampled_from(sorted(KEYS)), VALUES, max_size=3))
def test_any_document_is_a_container_or_an_error(entry: dict[str, Any]) -> None:
    with suppress(InputError):
        assert container_from(entry, {}).name == "robot"


def test_the_schema_accepts_valid_documents() -> None:
    validator = jsonschema.Draft202012Validator(schema_of(Container))
    validator.check_schema(validator.schema)
    entry = {"command": "run", "success": 3, "mounts": ["a:/b"], "artifacts": ["x"], "ready": {"port": 1}}
    assert validator.is_valid(entry)
    assert not validator.is_valid({"comand": "run"})
