"""Behaviour of the page that needs no browser."""

import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.addons.recorder.page import Page, beside, parsed
from calibration.addons.recorder.preview import Preview
from calibration.addons.recorder.recording import serving
from calibration.addons.recorder.session import Session
from calibration.base import InputError
from calibration.robot.simulation.motion import Motion, read_motion
from calibration.robot.simulation.system import System
from tests.addons.recorder.conftest import DATASETS

LONG = 20.0  # s


@pytest.mark.parametrize(
    ("name", "expected"), [("", "motion.json"), (" two.json ", "two.json"), ("a b.json", "a b.json")]
)
def test_a_name_is_that_of_a_file_beside_the_output(name: str, expected: str) -> None:
    assert beside(Path("folder/motion.json"), name) == Path("folder", expected)


@pytest.mark.parametrize(
    "name",
    [
        "a b",
        ".json",
        ".a.json",
        "calibration.yml",
        "a.json.py",
        "x/.json",
        "../motion.json",
        "/etc/motion.json",
        "a/b",
        "..",
        ".",
        "a/",
        "a\0b",
        "a\nb",
        57 * "a" + ".json",
    ],
)
def test_a_name_with_a_folder_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=r"^File name: found '"):
        beside(Path("folder/motion.json"), name)


def test_an_uploaded_sequence_is_read_and_called_by_its_name() -> None:
    content = (DATASETS / "t2rgb" / "motion.json").read_bytes()
    motion = parsed("mine.json", content)
    assert motion.source == "mine.json"
    expected = read_motion(DATASETS / "t2rgb" / "motion.json")
    np.testing.assert_array_equal(motion.positions, expected.positions)


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"[1]", b"\xff\xfe", b'{"2": {}}', b'{"1": {"position": {"x": NaN}}}', b"[" * 100_000]
)
def test_an_upload_that_is_no_sequence_is_said_in_one_line_with_its_name(content: bytes) -> None:
    with pytest.raises(InputError, match=r"^mine\.json: ") as error:
        parsed("mine.json", content)
    assert "\n" not in str(error.value)
    assert "/tmp" not in str(error.value)  # noqa: S108 (compared with, not written to)


def test_every_pose_of_a_sequence_is_looked_at_once_and_then_rated(systems: dict[str, System], tmp_path: Path) -> None:
    session = Session(systems["t2rgb"], read_motion(DATASETS / "t2rgb" / "motion.json").take([0, 1, 2, 3]))
    looked: list[Motion] = []
    rated = threading.Event()
    lengths: list[int] = []

    def look(pose: Motion) -> Preview:
        looked.append(pose)
        return Preview({}, ("no sensor",))

    def rate(motion: Motion) -> dict[str, tuple[float, float]]:
        lengths.append(len(motion))
        rated.set()
        raise InputError("nothing is determined")

    with serving("127.0.0.1", 0) as server:
        page = Page(server, session, tmp_path / "motion.json", look, rate)
        assert rated.wait(LONG)
        page.close()
    assert {id(pose) for pose in looked} == {id(pose) for pose in session.poses}
    assert len(looked) == 4
    assert lengths == [4]


def test_a_bug_where_one_looks_is_told_and_ends_nothing(
    systems: dict[str, System], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = Session(systems["t2rgb"])
    session.save()
    rated = threading.Event()

    def look(_: Motion) -> Preview:
        raise RuntimeError("out of light")

    def rate(_: Motion) -> dict[str, tuple[float, float]]:
        rated.set()
        return {}

    with serving("127.0.0.1", 0) as server:
        page = Page(server, session, tmp_path / "motion.json", look, rate)
        assert rated.wait(LONG)  # so the thread went on
        page.close()
    assert "RuntimeError: out of light" in capsys.readouterr().err


def test_a_browsers_answer_to_what_the_page_has_set_is_no_choice(systems: dict[str, System], tmp_path: Path) -> None:
    """It would take back the question whether a file is to be replaced."""
    session = Session(systems["t2rgb"], read_motion(DATASETS / "t2rgb" / "motion.json").take([0, 1, 2]))
    output = tmp_path / "motion.json"
    output.write_text("somebody else's")
    event = SimpleNamespace(client_id=1)
    with serving("127.0.0.1", 0) as server:
        page = Page(server, session, output, lambda _: Preview({}, ()), lambda _: {}, overwrite=True)
        with page._lock:  # the background shows the poses anew when it has looked at them
            page._export_sequence()
            page._choose_pose(event)  # type: ignore[arg-type]
            assert page._sequence.export.label == "Replace motion.json"
            page._sequence.choice.value = page._sequence.choice.options[2]
            page._choose_pose(event)  # type: ignore[arg-type]
            assert session.selected == 2
            assert page._sequence.export.label == "Export"
        page.close()
    assert output.read_text() == "somebody else's"


def test_a_pose_is_shown_when_it_differs_only_in_hidden_digits(systems: dict[str, System], tmp_path: Path) -> None:
    session = Session(systems["t2rgb"], read_motion(DATASETS / "t2rgb" / "motion.json").take([0]))
    with serving("127.0.0.1", 0) as server:
        page = Page(server, session, tmp_path / "motion.json", lambda _: Preview({}, ()), lambda _: {})
        poses = session.pose.model_poses
        assert poses is not None
        for shift, shown in ((0.0, True), (0.00004, True), (0.001, False)):
            moved = poses[0].copy()
            moved[0, 3] += shift
            assert page._numbers._is_shown(moved) is shown
        page.close()


def test_a_file_is_not_replaced_unless_the_command_line_lets_it(systems: dict[str, System], tmp_path: Path) -> None:
    session = Session(systems["t2rgb"], read_motion(DATASETS / "t2rgb" / "motion.json").take([0]))
    (tmp_path / "elsewhere").write_text("somebody else's")
    (tmp_path / "link.json").symlink_to("elsewhere")
    (tmp_path / "dangling.json").symlink_to("nowhere")
    (tmp_path / "motion.json").write_text("somebody else's")
    with serving("127.0.0.1", 0) as server:
        page = Page(server, session, tmp_path / "motion.json", lambda _: Preview({}, ()), lambda _: {})
        for name in ("motion.json", "link.json", "dangling.json"):
            page._sequence.file.value = name
            for _ in range(3):
                page._export_sequence()
        page.close()
    assert (tmp_path / "motion.json").read_text() == "somebody else's"
    assert (tmp_path / "elsewhere").read_text() == "somebody else's"
    assert [path.is_symlink() for path in sorted(tmp_path.glob("*.json"))] == [True, True, False]
    assert not (tmp_path / "nowhere").exists()
