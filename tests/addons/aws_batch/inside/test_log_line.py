from pathlib import Path

import pytest

from calibration.addons.aws_batch.inside.script import LOG_FILE, Signs
from calibration.addons.aws_batch.inside.watch import LogLine
from calibration.ci.execution.job import Container, Job
from calibration.ci.workflow.streams import LONGEST_LINE


@pytest.fixture
def log(tmp_path: Path) -> Path:
    signs = Signs(tmp_path)
    signs.make(Job("j", (Container("a", "i"),)))
    return tmp_path / "state" / "a" / LOG_FILE


def line(log: Path, pattern: str, most: int = 1000) -> LogLine:
    return LogLine(Signs(log.parents[2]), "a", pattern, most)


def append(log: Path, data: bytes) -> None:
    with log.open("ab") as file:
        file.write(data)


def test_a_line_that_comes_in_pieces(log: Path) -> None:
    looked = line(log, "^up and .*ng$")
    assert not looked.poll()  # the log does not exist yet
    for piece in (b"not up and running\nup a", b"nd runn", b"ing"):
        append(log, piece)
        assert not looked.poll()
    append(log, b"\nmore")
    assert looked.poll()
    assert looked.found


def test_only_complete_lines_count_but_for_those_without_an_end(log: Path) -> None:
    looked = line(log, "^x+$", 10**9)
    append(log, b"x" * LONGEST_LINE)
    assert not looked.poll()
    append(log, b"x")
    assert looked.poll()


def test_no_more_is_kept_than_may_be(log: Path) -> None:
    looked = line(log, "up")
    append(log, b"n" * 998 + b"\n")
    assert not looked.poll()
    assert log.stat().st_size == 999
    append(log, b"n\nu")
    assert not looked.poll()
    assert log.stat().st_size == 0
    append(log, b"p\n")
    assert looked.poll()
    append(log, b"n" * 2000)
    assert looked.poll()
    assert log.stat().st_size == 0


def test_a_link_is_not_followed(log: Path, tmp_path: Path) -> None:
    (tmp_path / "other").write_text("up\n" * 1000)
    log.symlink_to(tmp_path / "other")
    assert not line(log, "up").poll()
    log.unlink()
    looked = line(log, "up")
    append(log, b"n" * 1001)

    class Swapped(Signs):
        def open(self, name: str, sign: str, access: int = 0) -> int | None:
            found = super().open(name, sign, access)
            log.unlink(missing_ok=True)
            log.symlink_to(tmp_path / "other")
            return found

    looked._signs = Swapped(tmp_path)
    assert not looked.poll()
    assert (tmp_path / "other").stat().st_size == 3000


def test_binary_output(log: Path) -> None:
    append(log, b"\xff\x00up\xfe\n")
    assert line(log, "up").poll()
