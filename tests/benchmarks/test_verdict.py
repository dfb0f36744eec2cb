"""The catalogue of defects: its scenes are what they say, and a share of it is judged."""

import numpy as np
import pytest

from benchmarks.verdict import summary
from benchmarks.verdict.case import Case, Outcome, run
from benchmarks.verdict.kinds import KINDS
from benchmarks.verdict.strata import clean
from calibration.dataset.model import CornerLabels


@pytest.fixture(scope="module")
def good() -> Outcome:
    return run(Case("clean", "good", "riwbot", 0, 0, limits=False))


def test_the_catalogue_is_large_enough() -> None:
    assert len({kind.name for kind in KINDS}) == len(KINDS) >= 60
    assert all(kind.sizes and kind.words for kind in KINDS)


def test_a_clean_robot_is_no_harm_and_green(good: Outcome) -> None:
    assert (good.limits or 9) < 1
    assert not good.reasons
    assert not good.warnings


def test_a_scene_is_the_truth_with_noise() -> None:
    scene = clean("exact", "riwbot", 0)
    collection = scene.told.collections[3]
    ((_, sensor), labels) = next(iter(collection.labels.items()))
    assert isinstance(labels, CornerLabels)
    difference = labels.pixels - scene.expected(3, sensor, labels.ids)
    assert 0.03 < np.std(difference) < 0.2


@pytest.mark.parametrize("kind", ["focal length", "joint origin x", "pushed sensor"])
def test_a_large_defect_does_harm(kind: str) -> None:
    outcome = run(Case(kind, "exact", "riwbot", 2, 0))
    assert outcome.harmful
    assert not outcome.memory


def test_defects_that_do_nothing_do_no_harm() -> None:
    case = Case("described elsewhere", "exact", "riwbot", 0, 0)
    outcome = run(case)
    assert (outcome.limits or 9) < 1
    assert not outcome.must_be_red


def test_the_table_counts_what_was_found(good: Outcome) -> None:
    rows = [good, run(Case("focal length", "exact", "riwbot", 2, 0))]
    table = summary.readme_table(rows)
    assert table.splitlines()[2].startswith("| focal length |")
    assert any("focal length" in line for line in summary.lines(rows))
