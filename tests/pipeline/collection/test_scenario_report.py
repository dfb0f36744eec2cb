import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.ci.report import Report
from calibration.pipeline.collection.request import CollectionRequest, ScenarioRequest
from calibration.pipeline.collection.results import ScenarioResults
from calibration.pipeline.collection.scenario_report import document, report, scenarios_table
from calibration.robot.simulation.scenarios.scenario import ScenarioResult
from calibration.robot.simulation.scenarios.statistics import Statistics


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
        error_sigmas=None if error is None else 1.2,
        chance=None if error is None else 0.3,
        reasons=() if error is not None else ("no collection | has labels",),
    )


def many(errors: Sequence[float | None]) -> Statistics:
    return Statistics([result(i, error, **{"motion.sway_mm": float(i % 7)}) for i, error in enumerate(errors)])


@pytest.fixture(autouse=True)
def _no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Save the time to draw one."""
    monkeypatch.setattr("calibration.pipeline.collection.scenario_report.figure", lambda *_: b"")


def told(statistics: Statistics) -> Report:
    request = ScenarioRequest(CollectionRequest(Path("t2rgb")), len(statistics.results))
    return report(ScenarioResults("<b>t2rgb</b>", request, statistics), Path("out"))


def test_the_report_is_complete() -> None:
    errors = [0.2 + 0.1 * (i % 7) + 0.001 * i for i in range(40)]
    text = told(many([*errors[:-1], None])).markdown()
    assert text.startswith(
        "## Scenarios in simulation: fail: 39 of 40 scenarios of &lt;b&gt;t2rgb&lt;/b&gt; pass\n\n- success"
    )
    assert "39 of 40 scenarios calibrate; 440 of 480 poses gave a collection." in text
    assert "| Translation error (mm) | 0.2 |" in text
    assert "| s1-00039 | - | - | - | - | 11/12 | no collection &#124; has labels |" in text
    assert "| s1-00034 | 0.834 | 0.083 | 0.3 | 1.2 | 11/12 | calibrates |" in text
    assert "| motion.sway\\_mm | 4 | 6 | " in text
    command = "calibration collect-data-sim --system t2rgb --scenario {0} --output {0}\n"
    assert f"```\n{command.format('s1-00039')}{command.format('s1-00034')}" in text
    assert "| motion.sway\\_mm | +0.9" in text
    assert "- 40: left\\_camera: 0 markers, more than 8 needed" in text


def test_errors_that_chance_does_not_explain_are_findings() -> None:
    far, nearly, *others = many([0.5] * 12).results
    statistics = Statistics(
        [replace(far, error_sigmas=9.8, chance=1e-6), replace(nearly, error_sigmas=3.0, chance=2e-4), *others]
    )
    request = ScenarioRequest(CollectionRequest(Path("t2rgb")), 12)
    found = report(ScenarioResults("t2rgb", request, statistics, drivers={far.id: "motion (sway)"}), Path("out"))
    (finding,) = found.document["findings"]  # of twelve tests, 2e-4 is chance
    assert "s1-00000" in finding
    assert "9.8" in finding
    assert "motion (sway)" in finding
    assert finding in found.warnings
    assert finding in found.markdown()
    assert found.verdict == "pass"


def test_a_report_without_drivers() -> None:
    errors = np.random.default_rng(1).random(40).tolist()
    text = told(many(errors)).markdown()
    assert (
        "None of the parameters that vary (1) stands out. The strongest is motion.sway\\_mm, rank correlation" in text
    )


def test_too_few_scenarios_for_drivers() -> None:
    text = told(many([0.1, 0.2])).markdown()
    assert "Not known: it takes 10 scenarios." in text
    assert "| motion.sway\\_mm | 1 | 0 |" in text
    assert "motion.sway" not in told(many([0.1])).markdown()  # it varies between none
    assert "Not known: nothing varies." in told(Statistics([result(i, 0.1) for i in range(12)])).markdown()


def test_a_report_of_scenarios_that_all_fail() -> None:
    text = told(many([None] * 12)).markdown()
    assert "0 of 12 scenarios calibrate" in text
    assert "Translation error (mm)" not in text
    assert told(many([None])).markdown().count("0 of 1 scenario calibrate;") == 1


def test_the_table_has_a_row_for_each_scenario() -> None:
    results = many([0.5, None]).results
    first, second = csv.DictReader(io.StringIO(scenarios_table(results).csv()))
    assert first["id"] == "s1-00000"
    assert float(first["translation_mm"]) == 0.5
    assert (first["converged"], first["kept"], first["motion.sway_mm"]) == ("1", "11", "0.0")
    assert (second["converged"], second["translation_mm"], second["rms_px"]) == ("0", "", "")
    assert second["reasons"] == "no collection | has labels"
    assert "\r" not in scenarios_table(results).csv()
    assert scenarios_table(results).csv() == scenarios_table([replace(each) for each in results]).csv()
    assert scenarios_table(results[1:]).csv().splitlines()[1] == scenarios_table(results).csv().splitlines()[2]


def test_the_document_is_strict_json_with_all_of_it() -> None:
    statistics = many([0.5, None, *[0.1] * 10])
    read = json.loads(json.dumps(document(statistics), allow_nan=False))
    assert (read["count"], read["calibrated"]) == (12, 11)
    assert read["percentiles"]["translation_mm"]["100"] == 0.5
    assert read["worst"][:2] == ["s1-00001", "s1-00000"]
    assert read["drivers"][0].keys() == {"parameter", "correlation", "p", "stands_out"}
    row = read["scenarios"][1]
    assert (row["id"], row["translation_mm"], row["kept"]) == ("s1-00001", None, 11)
    assert row["lost"] == {"003": ["left_camera: 1 markers, more than 8 needed"]}
    assert document(many([None]))["percentiles"]["translation_mm"] == {}


@pytest.mark.parametrize("errors", [[math.pi], [None], [0.1] * 30])
def test_any_report_can_be_written(errors: list[float | None]) -> None:
    statistics = many(errors)
    assert told(statistics).markdown()
    assert json.dumps(document(statistics), allow_nan=False)
