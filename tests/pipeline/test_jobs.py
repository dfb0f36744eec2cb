"""Durations of jobs, as reported by themselves; invalid ones are no failure."""

from pathlib import Path

import pytest

from calibration.pipeline.gathering import SECONDS_FILE, parse_seconds, read_seconds


@pytest.mark.parametrize(("value", "seconds"), [("0", 0), ("61", 61), (" 7\n", 7), ("9999999", 9999999)])
def test_seconds(value: str, seconds: int) -> None:
    assert parse_seconds(value) == seconds


NO_SECONDS = ["", "-1", "1.5", "1e3", "NaN", "10000000", "٣", "1 2", "0x1", "$(date)", "***"]


@pytest.mark.parametrize("value", [*NO_SECONDS, 7, None, True, ["7"]])
def test_what_is_no_number_of_seconds_is_not_known(value: object) -> None:
    assert parse_seconds(value) is None


def test_the_file_of_a_job(tmp_path: Path) -> None:
    assert read_seconds(tmp_path) is None
    (tmp_path / SECONDS_FILE).write_text("42\n")
    assert read_seconds(tmp_path) == 42
    (tmp_path / SECONDS_FILE).write_bytes(b"\xff\xfe")
    assert read_seconds(tmp_path) is None
    (tmp_path / SECONDS_FILE).write_text("1" + " " * 100)
    assert read_seconds(tmp_path) is None
    (tmp_path / SECONDS_FILE).unlink()
    (tmp_path / SECONDS_FILE).mkdir()
    assert read_seconds(tmp_path) is None
