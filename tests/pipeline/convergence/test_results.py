"""The verdict of a sweep, and what is written of it."""

import csv
import io
import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import jsonschema
import pytest

from calibration.base import ExitCode
from calibration.base.tables.rules import parse_rules
from calibration.base.tables.table import read_table
from calibration.base.tables.table_verdict import judge
from calibration.ci.report import Report, remove_results
from calibration.ci.report.junit import junit_xml
from calibration.pipeline.convergence.convergence_map import ConvergenceResults, Largest, Minimums, least
from calibration.pipeline.convergence.report import (
    ALL_FILES,
    SCHEMA_FILE,
    first_lost,
    largest_noise,
    largest_table,
    map_table,
    report,
    starts,
)
from calibration.pipeline.system import NoiseGrid

from .cells import one_map

T, R = (0.0, 0.5, 1.0), (0.0, 1.5)
NOISE = NoiseGrid(T, R, (1, 2))
GOOD = one_map(T, R, lambda *_: True, NOISE.seeds)
LOST = one_map(T, R, lambda t, r, seed: not (t > 0.5 and seed == 2) and not (t == 0.5 and r), NOISE.seeds, "leg")
NOTHING = one_map(T, R, lambda *_: False, NOISE.seeds, "<b>|arm")


def results(*maps, translation: float | None = None, rotation: float | None = None) -> ConvergenceResults:  # type: ignore[no-untyped-def]
    return ConvergenceResults(NOISE, maps, Minimums(translation, rotation))


def told(found: ConvergenceResults) -> Report:
    return report(found, Path("out"))


def test_lost_starts_alone_do_not_fail() -> None:
    found = results(LOST)
    assert (found.verdict, found.exit_code, found.reasons) == ("pass", ExitCode.PASS, [])


def test_a_minimum_that_is_reached_passes_and_one_that_is_not_fails() -> None:
    assert results(LOST, translation=0.5, rotation=1.5).verdict == "pass"
    found = results(GOOD, LOST, translation=0.75, rotation=1.5)
    assert (found.verdict, found.exit_code) == ("fail", ExitCode.FAIL)
    assert found.reasons == [
        "leg, given: largest translation noise that always converges: found 0.5 m, expected at least 0.75 m"
    ]


def test_a_map_that_does_not_converge_without_noise_fails_without_any_minimum() -> None:
    found = results(GOOD, NOTHING)
    assert (found.verdict, found.exit_code) == ("fail", ExitCode.FAIL)
    assert found.reasons == ["<b>|arm, given: the start without noise does not converge: a false minimum"]
    assert found.largest == Largest(None, None, None)


def test_any_minimum_fails_where_nothing_converges() -> None:
    assert [check.passed for check in results(NOTHING, translation=0.0, rotation=0.0).checks] == [False, False]


def test_what_is_not_judged_has_no_part_in_verdict_and_outputs() -> None:
    found = results(GOOD, replace(NOTHING, judged=False), translation=1.0)
    assert (found.verdict, found.largest.translation, found.largest.diagonal) == ("pass", 1.0, (1.0, 1.5))
    assert "(to compare)" in largest_table(found).rows[1][0]


def test_nothing_judged_is_no_pass() -> None:
    assert results().verdict == "fail"
    assert results(replace(GOOD, judged=False)).verdict == "fail"


def test_the_outputs_are_the_least_of_the_maps() -> None:
    found = results(GOOD, LOST)
    assert found.largest == Largest(0.5, 1.5, (0.5, 0.0))
    assert least([]) is None
    assert least([1.0, None]) is None


@pytest.mark.parametrize("code", [ExitCode.BAD_INPUT, ExitCode.INFRASTRUCTURE])
def test_cells_that_could_not_run_have_their_own_exit_code(code: ExitCode) -> None:
    found = results(GOOD, one_map(T, R, lambda *_: False, NOISE.seeds, error=code))
    assert (found.verdict, found.exit_code) == ("fail", code)
    cases = ET.fromstring(junit_xml(told(found).suites))  # noqa: S314
    assert (cases.get("errors"), cases.get("failures")) == ("1", "0")


def test_an_infrastructure_failure_of_a_noisy_start_is_no_pass() -> None:
    found = results(one_map(T, R, lambda t, *_: t == 0, NOISE.seeds, error=ExitCode.INFRASTRUCTURE))
    assert (found.verdict, found.exit_code) == ("fail", ExitCode.INFRASTRUCTURE)
    assert found.reasons[0] == "arm, 0.5 m, 0 rad, seed 1: a false minimum"
    assert 'errors="1"' in junit_xml(told(found).suites)


@pytest.mark.parametrize("found", [results(GOOD), results(LOST, NOTHING, translation=1.0)])
def test_results_keep_to_their_schema(found: ConvergenceResults) -> None:
    written = json.loads(json.dumps(told(found).document, allow_nan=False))
    jsonschema.validate(written, json.loads(SCHEMA_FILE.read_text()), cls=jsonschema.Draft202012Validator)
    assert len(written["maps"][0]["pairs"]) == len(T) * len(R)


def test_the_lost_starts_are_named() -> None:
    pairs = {(p["translation_noise"], p["rotation_noise"]): p for p in told(results(LOST)).document["maps"][0]["pairs"]}
    assert pairs[0.0, 1.5]["share"] == 1
    assert pairs[1.0, 0.0]["share"] == 0.5
    assert pairs[1.0, 0.0]["lost"] == [{"seed": 2, "reasons": ["a false minimum"], "error": None}]


def test_the_table_has_a_row_for_each_pair_and_rules_apply_to_it(tmp_path: Path) -> None:
    found = results(GOOD, LOST)
    rows = list(csv.DictReader(io.StringIO(starts(found).csv())))
    assert len(rows) == 2 * len(T) * len(R)
    assert rows[-1]["Cell"] == "leg, given, 1 m, 1.5 rad"
    assert (rows[-1]["Share"], rows[-1]["Lost seeds"], rows[-1]["First reason"]) == ("0.5", "2", "a false minimum")
    (tmp_path / "convergence.csv").write_text(starts(found).csv())
    (tmp_path / "largest-noise.csv").write_text(largest_noise(results(GOOD, LOST, NOTHING)).csv())

    def passes(file: str, **rule: object) -> bool:
        rules = parse_rules({"rules": [rule]}, "rules")
        return judge(read_table(tmp_path / file), rules).passed

    assert passes("convergence.csv", column="Share", row="leg, given, 0.5 m, 0 rad", min=1)
    assert not passes("convergence.csv", column="Share", row="leg, given, 0.5 m, 1.5 rad", min=1)
    assert passes("largest-noise.csv", column="Translation noise (m)", row="arm, given", min=1)
    assert not passes("largest-noise.csv", column="Translation noise (m)", row="leg, given", min=1)
    assert not passes("largest-noise.csv", column="Rotation noise (rad)", row="<b>|arm, given", min=0)


def test_the_summary_shows_maps_and_escapes_names() -> None:
    assert map_table(LOST).rows == (("0 m", "100", "100"), ("0.5 m", "100", "0"), ("1 m", "50", "50"))
    text = told(results(LOST, NOTHING)).markdown()
    assert text.startswith("## Convergence: fail: the start without noise does not converge")
    assert "| 0.5 m | 100 | 0 |" in text
    assert "<b>" not in text
    noise = "--translation-noise 0.5 --rotation-noise 1.5 --seed-list 1 --start given"
    assert f"to look at it, calibration calibrate-matrix --dataset d {noise}" in first_lost(LOST, "--dataset d")
    command = f"calibration calibrate-matrix --config calibration.yml --systems leg {noise}"
    assert command in first_lost(LOST, "--config calibration.yml")
    assert first_lost(GOOD, "--dataset d") == ""
    assert "Starts that do not converge" not in told(results(GOOD)).markdown()
    assert told(results(LOST)).line.endswith("up to 0.5 m alone, 1.5 rad alone, and 0.5 m, 0 rad together")


def test_the_same_results_leave_the_same_files(tmp_path: Path) -> None:
    for name in ("one", "two"):
        told(results(GOOD, LOST, translation=1.0)).write(tmp_path / name)
    assert sorted(path.name for path in (tmp_path / "one").iterdir()) == sorted(ALL_FILES)
    for file in ALL_FILES:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_earlier_files_are_removed_and_nothing_else(tmp_path: Path) -> None:
    told(results(GOOD)).write(tmp_path)
    (tmp_path / "mine.csv").touch()
    remove_results(tmp_path, ALL_FILES)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.csv"]
