"""The player with a fake ROS system; a real one is in tests/integration/simulation."""

import json
import threading
import time
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.robot.simulation.ros1_player import (
    LONGEST,
    Answer,
    PlayError,
    Pose,
    as_answer,
    main,
    one_line,
    read_poses,
    within,
)

SEQUENCE = {
    str(number): {
        "position": {"x": number, "y": 0.5, "z": -1},
        "orientation": {"x": 0, "y": 0, "z": 0, "w": 1},
    }
    for number in range(1, 12)
}


class System:
    """Fake ROS system: takes poses, and answers as configured."""

    def __init__(self, answer: Callable[[int], Answer]) -> None:
        self.answer = answer
        self.done: list[object] = []

    def move(self, pose: Pose) -> None:
        self.done.append(pose)

    def wait(self, seconds: float) -> None:
        self.done.append(seconds)

    def save(self) -> Answer:
        self.done.append("save")
        return self.answer(self.done.count("save"))


@pytest.fixture
def motion(tmp_path: Path) -> Path:
    path = tmp_path / "motion.json"
    path.write_text(json.dumps(SEQUENCE))
    return path


def played(motion: Path, system: Any, *more: str) -> int:
    def connect(arguments: Namespace) -> Any:
        return system

    return main(["--motion", str(motion), *more], connect)


def test_every_pose_is_played_in_the_order_of_its_number(motion: Path) -> None:
    system = System(lambda _: Answer(saved=True, message=""))
    assert played(motion, system, "--settle", "0.25") == 0
    expected: list[object] = []
    for number in range(1, 12):  # "10" and "11" come after "9"
        expected += [(float(number), 0.5, -1.0, 0.0, 0.0, 0.0, 1.0), 0.25, "save"]
    assert system.done == expected


def test_a_pose_that_is_not_saved_is_reported_and_does_not_end_it(
    motion: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    system = System(lambda count: Answer(count != 3, f"answer {count}"))
    report = tmp_path / "report.json"
    assert played(motion, system, "--report", str(report)) == 0
    entries = json.loads(report.read_text())
    assert entries == [{"pose": n, "saved": n != 3, "answer": f"answer {n}"} for n in range(1, 12)]
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].startswith("pose 3/11: not saved: answer 3 (")
    assert lines[3].startswith("pose 4/11: saved: answer 4 (")
    assert lines[-1].startswith("10 of 11 poses saved in ")


def test_none_saved_is_a_failure(motion: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert played(motion, System(lambda _: Answer(saved=False, message=""))) == 1
    assert capsys.readouterr().err == "player: none of the 11 poses was saved\n"


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (PlayError("/save failed: out\nof disk"), "player: /save failed: out of disk\n"),
        (ImportError("No module named 'rospy'"), "player: ImportError: No module named 'rospy'\n"),
    ],
)
def test_an_error_ends_it_with_one_line_and_the_poses_before_stay_reported(
    motion: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], error: Exception, line: str
) -> None:
    def answer(count: int) -> Answer:
        if count == 2:
            raise error
        return Answer(saved=True, message="")

    assert played(motion, System(answer), "--report", str(tmp_path / "report.json")) == 1
    assert capsys.readouterr().err == line
    assert [entry["pose"] for entry in json.loads((tmp_path / "report.json").read_text())] == [1]


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("{", "is no motion sequence: "),
        ("[1]", "is no motion sequence: "),
        ("7", "is no motion sequence: "),
        ("{}", "has no pose"),
        ('{"2": {}}', "is no motion sequence: missing '1'"),
        ('{"1": {"position": {"x": 1, "y": 2}}}', "is no motion sequence: missing 'z'"),
        (json.dumps({"1": {**SEQUENCE["1"], "position": {"x": 1, "y": "a", "z": 0}}}), "is no motion sequence: "),
        (json.dumps({"1": {**SEQUENCE["1"], "position": {"x": 1, "y": 1e999, "z": 0}}}), "that is not finite"),
    ],
)
def test_a_file_that_is_no_sequence_is_a_failure(
    motion: Path, capsys: pytest.CaptureFixture[str], content: str, problem: str
) -> None:
    motion.write_text(content)
    assert played(motion, None) == 1
    error = capsys.readouterr().err
    assert error.startswith(f"player: {motion}: ")
    assert problem in error
    assert error.count("\n") == 1


def test_no_file_is_a_failure(tmp_path: Path) -> None:
    with pytest.raises(PlayError, match="No such file"):
        read_poses(str(tmp_path / "none.json"))


@pytest.mark.parametrize("option", [["--settle", "-1"], ["--timeout", "nan"], ["--settle", "a"]])
def test_seconds_are_seconds(option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["--motion", "m", *option])
    assert "invalid" in capsys.readouterr().err


def test_a_response_without_success_counts_as_saved() -> None:
    assert as_answer(object()).saved
    refused = as_answer(Namespace(success=False, message="no\x1b[31m image\n"))
    assert (refused.saved, refused.message) == (False, "no [31m image ")


@given(st.text(max_size=2 * LONGEST))
def test_foreign_text_is_one_short_line(text: str) -> None:
    line = one_line(text)
    assert len(line) <= LONGEST
    assert line.isprintable()
    if text.isprintable() and len(text) <= LONGEST:
        assert line == text


def test_a_call_that_hangs_is_given_up() -> None:
    with pytest.raises(PlayError, match=r"/save did not answer within 0\.05 s"):
        within(0.05, lambda: time.sleep(0.5), "/save")


def test_waiting_for_a_call_can_be_interrupted() -> None:
    go_on, asked = threading.Event(), []

    def stopped() -> None:
        asked.append(True)
        if len(asked) == 3:
            raise PlayError("stopped by SIGTERM")

    try:
        with pytest.raises(PlayError, match="stopped by SIGTERM"):
            within(600, lambda: go_on.wait(600), "/save", stopped)
    finally:
        go_on.set()


def test_a_call_s_result_and_its_error_arrive() -> None:
    assert within(5, lambda: 7, "/save") == 7
    with pytest.raises(KeyError, match="x"):
        within(5, lambda: {}["x"], "/save")
