"""Signals of containers, including hostile files in their place."""

import os
from pathlib import Path

import pytest

from calibration.addons.aws_batch.inside.script import BEAT_FILE, ENDED_FILE, LOG_FILE, PIPE_FILE, Signs
from calibration.base import InfrastructureError
from calibration.ci.execution.job import Container, Job

JOB = Job("j", (Container("a", "i"),))


@pytest.fixture
def signs(tmp_path: Path) -> Signs:
    signs = Signs(tmp_path / "job")
    signs.make(JOB)
    return signs


def state(signs: Signs) -> Path:
    return signs.folder / "state" / "a"


def test_state_folders_are_writable_for_all_users(signs: Signs) -> None:
    assert state(signs).stat().st_mode & 0o7777 == 0o1777
    assert signs.folder.stat().st_mode & 0o022 == 0


def test_signs_to_containers(signs: Signs) -> None:
    signs.start("a")
    signs.stop()
    assert (signs.folder / "start" / "a").is_file()
    assert (signs.folder / "stop").is_file()


def test_a_beat_changes(signs: Signs) -> None:
    assert signs.beat("a") is None
    beat = state(signs) / BEAT_FILE
    beat.touch()
    first = signs.beat("a")
    os.utime(beat, ns=(1, 1))
    assert first is not None
    assert signs.beat("a") == 1


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("0 0\n", (0, False)),
        ("137 1\n", (137, True)),
        ("", None),
        ("1", None),
        ("1 x\n", None),
        ("-1 0\n", None),
        ("0 0 0\n", None),
        ("9" * 200 + " 0\n", None),
        ("300 2\n", (44, True)),
    ],
)
def test_how_it_ended(signs: Signs, text: str, found: tuple[int, bool] | None) -> None:
    assert signs.ended("a") is None
    (state(signs) / ENDED_FILE).write_text(text)
    assert signs.ended("a") == found


def test_nothing_but_a_file_is_read(signs: Signs, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("0 0\n")
    place = state(signs) / ENDED_FILE
    place.symlink_to(tmp_path / "secret")
    assert signs.ended("a") is None
    place.unlink()
    os.mkfifo(place)
    assert signs.ended("a") is None  # without waiting for a writer
    place.unlink()
    place.mkdir()
    assert signs.ended("a") is None
    assert signs.has("a", ENDED_FILE)
    assert not signs.has("a", PIPE_FILE)
    assert signs.open("a", LOG_FILE) is None


def test_unwritable_folders(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    signs = Signs(tmp_path / "file")
    for act in (lambda: signs.make(JOB), signs.stop, lambda: signs.start("a")):
        with pytest.raises(InfrastructureError, match=r"file.*: cannot be written: Not a directory"):
            act()
