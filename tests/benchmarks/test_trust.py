"""The group trust: what its rows count, and its folder."""

import pkgutil
from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import pytest

from benchmarks import trust
from benchmarks.rows import Row
from benchmarks.trust import moves
from benchmarks.trust.defects import most_green, of_unforeseen
from benchmarks.trust.good_robots import Draw, judge
from benchmarks.verdict.case import Case, Outcome, colour_of, run
from calibration.engine.diagnosis.finding import Finding, Severity
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.pipeline.matrix.cell_result import Cell, nothing_yet


@pytest.fixture(scope="module")
def harmful() -> Outcome:
    outcome = run(Case("raw images", "good", "riwbot", 2, 0, limits=False))
    assert outcome.harmful
    assert outcome.red
    return outcome


def test_undecided_is_neither_red_nor_green(harmful: Outcome) -> None:
    undecided = replace(harmful, red=False, undecided=True)
    green = replace(harmful, red=False, named=0)
    found = [harmful, harmful, undecided, green]
    values = {row.name.rpartition(", ")[2]: row.value for row in of_unforeseen(found)}
    assert values == {"red": 50, "green": 25, "named": 100}
    assert most_green(found) == "raw images 1 of 4"


def test_a_reason_that_is_not_an_undecided_finding_is_red() -> None:
    cell = replace(nothing_yet(Cell("robot", StartingNoise())), converged=True)
    undecided = Finding("precision", cast("Severity", "undecided"), "it can show 3 mm")
    assert colour_of(cell) == "green"
    assert colour_of(replace(cell, findings=(undecided,), reasons=(undecided.text,))) == "undecided"
    assert colour_of(replace(cell, findings=(undecided,), reasons=(undecided.text, "a rule"))) == "red"
    assert colour_of(replace(cell, converged=False)) == "red"


def test_every_module_of_the_folder_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    def rows(name: str, quick: bool) -> Iterator[Row]:
        yield Row(f"{name}, {quick}")

    names = [module.name for module in pkgutil.iter_modules(trust.__path__)]
    for name in names:
        monkeypatch.setattr(f"benchmarks.trust.{name}.rows", lambda quick, name=name: rows(name, quick))
    assert [row.name for row in trust.measure(quick=True)] == [f"{name}, True" for name in names]
    assert {"defects", "good_robots", "moves"} <= set(names)


def test_a_sensor_that_moves_in_the_middle_is_red_and_named() -> None:
    found = moves.moved(2)
    assert 0 < found.first < found.collections
    assert (found.colour, found.named) == ("red", True)


def test_a_clean_recording_with_a_limit_within_its_error_bar_is_undecided() -> None:
    """What varies by chance moves the result by less than its error bar says anyway."""
    [found] = judge([Draw(0, 30, 1.0)])
    assert found.colour == "undecided"
