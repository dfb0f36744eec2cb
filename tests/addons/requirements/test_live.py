"""The live watch, against a stand-in of a rosbridge server: what ends the containers early, and what does not."""

import io
import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
import websockets
from websockets.sync.server import ServerConnection, serve

from calibration.addons.requirements import live
from calibration.addons.requirements.live import RosbridgeWatch, live_watch, requirements_of_one_message
from calibration.addons.requirements.requirement import Message
from calibration.addons.requirements.settings import RequirementSettings
from calibration.base import InputError
from calibration.base.records import read
from calibration.ci.execution.job import OUTPUT, Artifact, Job, Mount
from calibration.ci.execution.outcome import ARTIFACTS_FOLDER, LOGS_FOLDER, End
from calibration.ci.workflow import Runner
from calibration.pipeline.collection import collecting
from calibration.pipeline.collection.request import CollectionRequest
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.running import PipelineRun
from tests.integration.execution.jobs import python, run_jobs, shell

SECTION: dict[str, object] = {
    "bag": "simulation:drive",
    "topics": {
        "/scan": {"within": "1s", "min-rate": 5, "fields": {"ranges": {"min": 0.1}, "header.stamp.sec": {"min": 1}}}
    },
    "hpl": ["globally: no /cmd_vel {linear.x > 1}"],
}
STAMP = {"stamp": {"secs": 5, "nsecs": 0}}
GOOD = [("/scan", {"header": STAMP, "ranges": [0.5, 2]}), ("/cmd_vel", {"linear": {"x": 1.0}})]
FAST = ("/cmd_vel", {"linear": {"x": 1.5}})


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "RETRY_SECONDS", 0.02)
    monkeypatch.setattr(live, "_POLL_SECONDS", 0.02)


def settings(document: dict[str, object]) -> RequirementSettings:
    return read(RequirementSettings, document, "requirements", folder=Path())


@contextmanager
def rosbridge(handler: Callable[[ServerConnection], None]) -> Iterator[int]:
    with serve(handler, "127.0.0.1", 0, compression=None) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.socket.getsockname()[1]
        finally:
            server.shutdown()
            thread.join()


def publishing(*messages: tuple[str, Any] | str | bytes) -> Callable[[ServerConnection], None]:
    """Return a handler that sends each message when its topics are subscribed, and then waits for the client."""

    def handler(connection: ServerConnection) -> None:
        asked = [json.loads(connection.recv()) for _ in range(2)]
        assert [(each["op"], each["topic"]) for each in asked] == [("subscribe", "/cmd_vel"), ("subscribe", "/scan")]
        for each in messages:
            is_raw = isinstance(each, str | bytes)
            connection.send(each if is_raw else json.dumps({"op": "publish", "topic": each[0], "msg": each[1]}))
        for _ in connection:
            pass

    return handler


def watched(
    handler: Callable[[ServerConnection], None], until: Callable[[RosbridgeWatch, list[str]], object], **section: object
) -> tuple[str, list[str]]:
    """Watch the stand-in until something holds; return the reason and the log."""
    notes: list[str] = []
    with rosbridge(handler) as port:
        watch = RosbridgeWatch(
            requirements_of_one_message(settings({**SECTION, **section})), port, lambda: ["127.0.0.1"], notes.append
        )
        deadline = time.monotonic() + 10
        while not until(watch, notes) and time.monotonic() < deadline:
            time.sleep(0.005)
        watch.close()
    assert not watch._thread.is_alive()
    return watch.reason, notes


def has_reason(watch: RosbridgeWatch, _: list[str]) -> object:
    return watch.reason


@pytest.mark.parametrize(
    ("message", "found"),
    [
        (FAST, "linear.x = 1.5"),
        (("/scan", {"header": STAMP, "ranges": [0.5, 0.05]}), "ranges: found 0.05"),
        (("/scan", {"header": {"stamp": {"sec": 0, "nanosec": 9}}, "ranges": [1]}), "header.stamp.sec: found 0"),
    ],
)
def test_a_message_that_contradicts_a_requirement_is_the_reason(message: tuple[str, Any], found: str) -> None:
    reason, notes = watched(publishing(*GOOD, message), has_reason)
    assert found in reason
    assert "/scan, /cmd_vel" in notes[0]


def test_a_topic_that_is_not_there_yet_is_subscribed_again() -> None:
    asked: list[str] = []

    def handler(connection: ServerConnection) -> None:
        while asked.count("/cmd_vel") < 3:
            asked.append(json.loads(connection.recv())["topic"])
            connection.send(json.dumps({"op": "status", "level": "error", "msg": "topic not established"}))
        connection.send(json.dumps({"op": "publish", "topic": FAST[0], "msg": FAST[1]}))

    reason, _ = watched(handler, has_reason)
    assert "/cmd_vel" in reason


@pytest.mark.parametrize(
    "hostile",
    [
        "{",
        b"\xff\xfe",
        "[" * 100_000,
        '{"op": "publish", "topic": ["/scan"], "msg": {}}',
        '{"op": "publish", "topic": "/other", "msg": {"linear": {"x": 9}}}',
        '{"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": NaN}}}',
        '{"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": 1' + "0" * 400 + "}}}",
        '{"op": "publish", "topic": "/cmd_vel", "msg": ' + "[" * 500 + "]" * 500 + "}",
        '{"op": "publish", "topic": "/scan", "msg": {"header": {"stamp": 7}, "ranges": "AAAA"}}',
        ("/cmd_vel", {"linear": {"x": None}}),
        ("/cmd_vel", {"linear": 9}),
        ("/cmd_vel", None),
        ("/scan", {"ranges": []}),
    ],
    ids=range(13),
)
def test_what_is_no_such_message_contradicts_nothing(hostile: tuple[str, Any] | str | bytes) -> None:
    end = ("/scan", {"header": {"stamp": {"secs": 0}}})
    reason, _ = watched(publishing(hostile, *GOOD, end), has_reason)
    assert "header.stamp.sec" in reason


def test_a_value_of_another_kind_ends_the_watch_of_its_requirement_with_a_note() -> None:
    reason, notes = watched(publishing(("/cmd_vel", {"linear": {"x": "AA"}}), FAST), lambda _, notes: len(notes) > 1)
    assert (reason, "not watched on /cmd_vel" in notes[1]) == ("", True)


def test_a_message_that_is_too_large_ends_the_watch_with_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "MAX_MESSAGE_BYTES", 1000)
    large = ("/scan", {"header": STAMP, "ranges": [0.0] * 1000})
    reason, notes = watched(publishing(large), lambda _, notes: len(notes) > 1)
    assert (reason, "nothing more is watched" in notes[1]) == ("", True)


def test_a_topic_of_which_nothing_comes_is_noted_with_what_rosbridge_says() -> None:
    refusal = json.dumps({"op": "status", "level": "error", "msg": "no such type"})
    _, notes = watched(publishing(refusal, GOOD[0]), lambda watch, _: watch._silent == {"/cmd_vel"})
    assert notes[1:] == ["no message came of /cmd_vel; rosbridge says: no such type"]


def test_what_is_no_rosbridge_is_noted_at_the_end() -> None:
    notes: list[str] = []
    watch = RosbridgeWatch(requirements_of_one_message(settings(SECTION)), 1, lambda: ["127.0.0.1"], notes.append)
    watch.close()
    assert (watch.reason, len(notes), "port 1" in notes[0]) == ("", 1, True)


@pytest.mark.parametrize(
    "later",
    [
        "globally: some /a",
        "globally: no /a {x > 1} within 2 s",
        "after /p: no /a {x > 1}",
        "until /p: no /a {x > 1}",
        "globally: /a causes /b within 1 s",
        "globally: /a forbids /b",
        "globally: /b requires /a",
    ],
)
def test_what_needs_an_order_a_time_or_a_missing_message_is_left_to_the_bag(later: str) -> None:
    assert requirements_of_one_message(settings({"hpl": [later]})) == []


def test_a_limit_that_an_array_of_float32_reaches_is_not_contradicted() -> None:
    """A bag's array is compared in float32, where the number 0.1 and the limit 0.1 are equal."""
    kept = {"fields": {"a": {"max": 0.1, "min": 0.1, "equals": 0.1}}}
    [requirement] = requirements_of_one_message(settings({"topics": {"/a": kept}}))
    fields = live.fields_of_json({"a": [0.10000000149011612]}, {"a": {}}, True)
    requirement.feed(Message("/a", 0, fields, 1))
    assert not requirement.is_refuted


def test_only_the_entry_whose_bag_is_judged_is_watched() -> None:
    assert live_watch(settings(SECTION), "drive", 9090) is not None
    assert live_watch(settings(SECTION), "other", 9090) is None
    with pytest.raises(InputError, match=r"requirements\.hpl\[0\]"):
        live_watch(settings({**SECTION, "hpl": ["globally no"]}), "drive", 9090)


CONFIGURATION = """
simulation:
  drive: {{ros: 1, containers: {{robot: {{image: "robot:1", command: run}}}}, record: {{rosbridge: 9090}}}}
requirements: {{bag: "simulation:{name}", topics: {{/a: {{fields: {{x: {{max: 1}}}}}}}}}}
"""


@pytest.mark.parametrize(("name", "is_watched"), [("drive", True), ("other", False)])
def test_the_stage_collect_watches_the_containers_whose_bag_is_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, is_watched: bool
) -> None:
    found: list[bool] = []

    def collect(request: CollectionRequest, *_: object, **__: object) -> None:
        assert request.target is not None
        found.append(request.target.watch is not None)
        raise InputError("enough")

    monkeypatch.setattr(collecting, "collect_dataset", collect)
    path = tmp_path / "calibration.yml"
    path.write_text(CONFIGURATION.format(name=name))
    of, log = read_configuration(path), io.StringIO()
    runner = Runner(stdout=log, stderr=log)
    run = PipelineRun(Matrix((), of.noise), tmp_path, runner, simulations=of.simulations, sections=of.sections)
    collecting.collect_stage(run)
    assert found == [is_watched]
    assert ("nothing is watched" in log.getvalue()) != is_watched


STAND_IN = f"""
import json
from websockets.sync.server import serve
def handler(connection):
    connection.recv()
    connection.send(json.dumps({{"op": "publish", "topic": "{FAST[0]}", "msg": {FAST[1]}}}))
    connection.recv()
serve(handler, "", 9090).serve_forever()
"""
RECORDER = f"trap 'echo closed > {OUTPUT}/bag; exit' TERM; sleep 600 & wait"


def test_in_containers_the_recorder_closes_its_bag_when_the_watch_ends_the_job(
    tmp_path: Path, python_image: str
) -> None:
    library = Mount(Path(websockets.__file__).parent, "/packages/websockets")
    robot = python(STAND_IN, "robot", environment={"PYTHONPATH": "/packages"}, mounts=(library,))
    recorder = shell(RECORDER, "recorder", essential=False, artifacts=(Artifact(f"{OUTPUT}/bag"),))
    watch = live_watch(settings(SECTION), "drive", 9090)
    [outcome] = run_jobs(tmp_path, Job("job", (robot, recorder), seconds=60), watch=watch)
    assert ("linear.x = 1.5" in outcome.reasons[0], outcome.exit_code) == (True, 1)
    assert [each.end for each in outcome.containers] == [End.STOPPED, End.STOPPED]
    assert (outcome.folder / ARTIFACTS_FOLDER / "bag").read_text() == "closed\n"
    assert "/cmd_vel" in (outcome.folder / LOGS_FOLDER / "live_watch.log").read_text()
