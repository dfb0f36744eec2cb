from pathlib import Path

import pytest

from calibration.base import InfrastructureError
from calibration.ci.workflow.streams import LONGEST_LINE, LogFile


def test_kept_as_it_is_and_read_in_lines(tmp_path: Path) -> None:
    lines: list[str] = []
    with LogFile(tmp_path / "log", show=lines.append, pattern=r"up on \d+") as log:
        for chunk in (b"one\ntw", b"o \xff\x1b[31m\n\n", b"up on 80"):
            log.feed(chunk)
        assert lines == ["one", "two �\x1b[31m", ""]
        assert not log.found
    assert log.found
    assert lines[-1] == "up on 80"
    assert log.last_line == "up on 80"
    assert (tmp_path / "log").read_bytes() == b"one\ntwo \xff\x1b[31m\n\nup on 80"
    log.close()


def test_truncation_is_stated(tmp_path: Path) -> None:
    lines: list[str] = []
    with LogFile(tmp_path / "log", show=lines.append, most_bytes=10) as log:
        log.feed(b"0123456")
        log.feed(b"789abc\n")
        log.feed(b"more\n")
    assert (tmp_path / "log").read_bytes() == b"0123456789\n(cut here: 9 more bytes were not kept)\n"
    assert lines == ["0123456789abc", "more"]  # the display has a separate limit
    assert log.last_line == "more"


def test_a_line_without_an_end_is_looked_at_in_pieces(tmp_path: Path) -> None:
    lines: list[str] = []
    with LogFile(tmp_path / "log", show=lines.append) as log:
        for _ in range(10):
            log.feed(b"x" * LONGEST_LINE)
        assert len(lines) == 9
    assert sum(map(len, lines)) == 10 * LONGEST_LINE


def test_secrets_are_in_neither(tmp_path: Path) -> None:
    lines: list[str] = []
    with LogFile(tmp_path / "log", ["hunter2"], lines.append) as log:
        log.feed(b"it is hun")
        log.feed(b"ter2\nhunte")
        log.feed(b"r2")
    assert (tmp_path / "log").read_bytes() == b"it is ***\n***"
    assert lines == ["it is ***", "***"]
    assert log.last_line == "***"


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(InfrastructureError, match="the log cannot be written: No such file or directory"):
        LogFile(tmp_path / "nosuch" / "log")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk(tmp_path: Path) -> None:
    (tmp_path / "log").symlink_to("/dev/full")
    with (
        LogFile(tmp_path / "log") as log,
        pytest.raises(InfrastructureError, match="the log cannot be written: No space left"),
    ):
        log.feed(b"x")
