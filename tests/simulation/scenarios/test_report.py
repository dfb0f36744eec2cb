import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.simulation.scenarios.report import Report, document, markdown, table
from calibration.simulation.scenarios.result import ScenarioResult


def result(index: int, error: float | None, **values: float) -> ScenarioResult:
    return ScenarioResult(
        f"s1-{index:05d}",
        f"{index:012x}",
        values,
        poses=12,
        lost={"003": (f"left_camera: {index} markers, more than 8 needed",)},
        detection={"left_camera": 11 / 12, "right_camera": 1.0},
        corner_rms_px=0.05,
        converged=error is not None,
        rms_px=None if error is None else 0.04,
        translation_mm=error,
        rotation_deg=None if error is None else error / 10,
        sigma_mm=None if error is None else 0.3,
        reasons=() if error is not None else ("no collection | has labels",),
    )


def many(errors: Sequence[float | None]) -> Report:
    return Report([result(i, error, **{"motion.sway_mm": float(i % 7)}) for i, error in enumerate(errors)])


def replay(world: str) -> str:
    return f"calibration collect-data-sim --system t2rgb --scenario {world}"


@settings(deadline=None)
@given(st.lists(st.floats(0, 1e3), min_size=1, max_size=60))
def test_percentiles_are_values_of_worlds(errors: list[float]) -> None:
    found = many(errors).percentiles("translation_mm")
    assert list(found) == [0, 5, 25, 50, 75, 95, 100]
    assert (found[0], found[100]) == (min(errors), max(errors))
    expected = np.percentile(errors, list(found), method="inverted_cdf")
    assert list(found.values()) == expected.tolist()


def test_the_worst_are_those_without_a_calibration_then_the_largest_errors() -> None:
    report = many([0.5, None, 3.0, 0.1, None, 3.0])
    assert [r.id for r in report.worst(4)] == ["s1-00001", "s1-00004", "s1-00002", "s1-00005"]
    assert len(report.worst(100)) == 6


def test_the_report_says_it_all() -> None:
    errors = [0.2 + 0.1 * (i % 7) + 0.001 * i for i in range(40)]
    text = markdown(many([*errors[:-1], None]), "40 worlds of <b>t2rgb</b>", replay, worst=2)
    assert "## 40 worlds of &lt;b&gt;t2rgb&lt;/b&gt;" in text
    assert "39 of 40 worlds calibrate; 440 of 480 poses gave a collection." in text
    assert "| Translation error (mm) | 0.2 |" in text
    assert "| s1-00039 | - | - | - | 11/12 | no collection &#124; has labels |" in text
    assert "| s1-00034 | 0.834 | 0.083 | 0.3 | 11/12 | calibrates |" in text
    assert "| motion.sway\\_mm | 4 | 6 |" in text
    assert "```\n" + replay("s1-00039") + "\n" + replay("s1-00034") + "\n```" in text
    assert "| motion.sway\\_mm | +0.9" in text
    assert "- 40: left\\_camera: 0 markers, more than 8 needed" in text


def test_where_nothing_drives_the_error_it_says_so() -> None:
    errors = np.random.default_rng(1).random(40).tolist()
    text = markdown(many(errors), "40 worlds", replay)
    assert (
        "None of the parameters that vary (1) stands out. The strongest is motion.sway\\_mm, rank correlation" in text
    )


def test_few_worlds_tell_nothing_of_drivers() -> None:
    text = markdown(many([0.1, 0.2]), "2 worlds", replay)
    assert "Not known: it takes 10 worlds." in text
    assert "| motion.sway\\_mm | 1 | 0 |" in text
    assert "motion.sway" not in markdown(many([0.1]), "1 world", replay)  # it varies between none
    assert "Not known: nothing varies." in markdown(Report([result(i, 0.1) for i in range(12)]), "12 worlds", replay)


def test_a_report_of_worlds_that_all_fail() -> None:
    text = markdown(many([None] * 12), "12 worlds", replay)
    assert "0 of 12 worlds calibrate" in text
    assert "Translation error (mm)" not in text
    assert markdown(many([None]), "1 world", replay).count("0 of 1 world calibrate;") == 1


def test_the_table_has_a_row_for_each_world() -> None:
    results = many([0.5, None]).results
    first, second = csv.DictReader(io.StringIO(table(results)))
    assert first["id"] == "s1-00000"
    assert float(first["translation_mm"]) == 0.5
    assert (first["converged"], first["kept"], first["motion.sway_mm"]) == ("1", "11", "0.0")
    assert (second["converged"], second["translation_mm"], second["rms_px"]) == ("0", "", "")
    assert second["reasons"] == "no collection | has labels"
    assert "\r" not in table(results)
    assert table(results) == table([replace(each) for each in results])
    assert table(results[1:]).splitlines()[1] == table(results).splitlines()[2]


def test_the_document_is_strict_json_with_all_of_it() -> None:
    report = many([0.5, None, *[0.1] * 10])
    read = json.loads(json.dumps(document(report), allow_nan=False))
    assert (read["worlds"], read["calibrated"]) == (12, 11)
    assert read["percentiles"]["translation_mm"]["100"] == 0.5
    assert read["worst"][:2] == ["s1-00001", "s1-00000"]
    assert read["drivers"][0].keys() == {"parameter", "correlation", "p", "stands_out"}
    row = read["scenarios"][1]
    assert (row["id"], row["translation_mm"], row["kept"]) == ("s1-00001", None, 11)
    assert row["lost"] == {"003": ["left_camera: 1 markers, more than 8 needed"]}
    assert document(many([None]))["percentiles"]["translation_mm"] == {}


@pytest.mark.parametrize("errors", [[math.pi], [None], [0.1] * 30])
def test_any_report_can_be_written(errors: list[float | None]) -> None:
    report = many(errors)
    assert markdown(report, "worlds", replay)
    assert json.dumps(document(report), allow_nan=False)
