"""Fuzzing: a bounded share of it, what it has found, and whether it would find anything."""

import contextlib
import re
import time
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from tests.campaigns import fuzz
from tests.campaigns.fuzz import campaign, problem_of
from tests.campaigns.mutations import mutated
from tests.campaigns.target import Target
from tests.campaigns.targets import TARGETS

FOUND: list[tuple[str, int]] = [
    ("calibration", 1344609849),
    ("ros2-db3", 1982475173),
    ("intrinsics", 1282849089),
    ("intrinsics", 102923761),
    ("rules", 1272987056),
    ("rules", 1099103031),
    ("opencv", 173518645),
    ("reference", 83892483),
]
"""Cases that failed once, by target and seed: each stays as it should be."""


@pytest.mark.parametrize("name", TARGETS)
def test_every_reader_reads_its_files_as_they_are(name: str, tmp_path: Path) -> None:
    target = TARGETS[name]
    for number, original in enumerate(target.originals()):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / target.name).write_bytes(original)
        target.read(folder / target.name)


def test_a_share_of_the_campaign() -> None:
    found = campaign(800, 1, list(TARGETS), 30)
    assert found.failures == []
    assert found.read
    assert found.refused


def test_what_was_found_stays_mended() -> None:
    known = [(name, seed) for name, seed in FOUND if name in TARGETS]  # those of a deleted add-on are none
    assert [(name, seed) for name, seed in known if problem_of(TARGETS[name], seed)] == []


def test_a_case_is_the_same_by_its_seed_and_others_are_not() -> None:
    text = b'{"a": 1, "b": [2.5, "three"]}'
    assert [mutated(text, seed) for seed in range(50)] == [mutated(text, seed) for seed in range(50)]
    assert len({mutated(text, seed) for seed in range(50)}) > 40


def _bug(_: Path) -> None:
    raise KeyError("planted")


def _memory(_: Path) -> None:
    np.zeros(fuzz.ADDRESSES)


def test_memory_and_time_of_each_case_are_measured() -> None:
    found = fuzz.Campaign()
    found.run("small", Target("file", lambda: [b"1"], lambda path: path.read_bytes()), 7)
    assert found.failures == []
    found.run("large", Target("file", lambda: [b"1"], lambda _: np.ones(200 << 17).sum()), 7)
    assert found.failures == []
    assert found.largest["small"] < 50 << 20 < 190 << 20 < found.largest["large"]
    assert set(found.slowest) == {"small", "large"}


def test_a_case_that_uses_too_much_memory_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "MEMORY", 100 << 20)
    found = fuzz.Campaign()
    found.run("large", Target("file", lambda: [b"1"], lambda _: np.ones(200 << 17).sum()), 7)
    assert re.fullmatch(r"large --case 7: (199|2\d\d) MiB", found.failures[0])


def _long(_: Path) -> None:
    error = InputError("x")
    error.args = ("two\nlines",)
    raise error


def _unsolvable(_: Path) -> None:
    np.linalg.inv(np.zeros((2, 2)))


def _slow(_: Path) -> None:
    with contextlib.suppress(Exception):  # what catches everything does not hide that it takes too long
        time.sleep(60)


@pytest.mark.parametrize(
    ("read", "problem"),
    [
        (_bug, r"KeyError: 'planted' \(test_fuzz.py:\d+\)"),
        (_memory, ".*MemoryError: "),
        (_long, "an error of 2 lines"),
        (_slow, "not done after 1 s"),
        (_unsolvable, "$"),
        (lambda path: path.read_bytes(), None),
    ],
)
def test_what_goes_wrong_is_found(read: object, problem: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzz, "SECONDS", 1)
    found = problem_of(Target("file", lambda: [b"1"], read), 7)  # type: ignore[arg-type]
    assert found is None if problem is None else re.match(problem, found or "")
