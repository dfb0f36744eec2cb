"""results.json and its company."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest
from defusedxml.ElementTree import fromstring

from calibration.base import ExitCode, InputError
from calibration.ci.report import Report
from calibration.ci.workflow.runner import Level
from calibration.engine.diagnosis.finding import Finding
from calibration.pipeline.matrix.cell_result import CellResult, Details, Deviation, ParameterResult
from calibration.pipeline.matrix.matrix import Matrix, run_matrix
from calibration.pipeline.report import CELLS_A_PROCESS, failures, findings_of, report, write_cells, write_results
from calibration.pipeline.report_tables import grid, parameters_table, precision_table, truth_table
from calibration.pipeline.results import (
    SCHEMA_FILE,
    ImageResult,
    PipelineResults,
    clear_results,
    read_results,
    results_of,
    without_verdicts,
)
from calibration.pipeline.system import NoiseGrid
from tests.pipeline.conftest import RIWBOT
from tests.pipeline.matrix.test_cell_verdict import CELL

FAILED = replace(CELL, rotation_noise=0.5, converged=False, reasons=("a false minimum",), rms_px=None, truth=None)
BROKEN = replace(FAILED, seed=2, reasons=("no labels | <b>",), error=ExitCode.BAD_INPUT)


def told(results: PipelineResults) -> Report:
    return report(results, Path("out"))


def test_real_results_follow_their_schema_and_read_back(tmp_path: Path) -> None:
    found = run_matrix(Matrix((replace(RIWBOT, compare=("shah", "opencv-stereo")),), NoiseGrid()), tmp_path, 1)
    results = PipelineResults(found.cells, found.comparisons)

    write_results(results, tmp_path)

    schema = json.loads(SCHEMA_FILE.read_text())
    document = json.loads((tmp_path / "results.json").read_text())
    jsonschema.validate(document, schema)
    assert found.cells[0].dataset is not None
    own = json.loads((tmp_path / found.cells[0].dataset).with_name("results.json").read_text())
    jsonschema.validate(own, schema)
    assert own["cells"][0]["transforms"][0]["sigma_mm"] > 0
    assert without_verdicts(results_of(tmp_path)) == results


def test_results_of_an_older_version_are_read(tmp_path: Path) -> None:
    """Without what was added since; what a newer version adds is left alone."""
    write_results(PipelineResults((CELL, FAILED)), tmp_path)
    path = tmp_path / "results.json"
    document = json.loads(path.read_text())
    for key in ("reasons", "comparisons", "collections", "image", "summary"):
        del document[key]
    for cell in document["cells"]:
        for key in ("loss", "sigma", "detail", "warnings", "findings"):
            del cell[key]
        cell["of_a_newer_version"] = 1
    path.write_text(json.dumps(document))
    assert read_results(tmp_path).cells == tuple(replace(cell, loss=None) for cell in (CELL, FAILED))


def test_writing_what_was_read_changes_nothing(tmp_path: Path) -> None:
    found = run_matrix(Matrix((RIWBOT,), NoiseGrid()), tmp_path, 1)
    write_results(PipelineResults(found.cells), tmp_path)
    before = {p: p.read_bytes() for p in tmp_path.rglob("results.json")}

    write_results(without_verdicts(results_of(tmp_path)), tmp_path)

    assert {p: p.read_bytes() for p in tmp_path.rglob("results.json")} == before
    assert len(before) == 2


def test_many_cells_are_written_by_several_processes_as_by_one(tmp_path: Path) -> None:
    cells = tuple(
        replace(CELL, seed=seed, dataset=f"s/seed-{seed}/dataset.json", details=Details(iterations=seed))
        for seed in range(2 * CELLS_A_PROCESS + 1)
    )
    for jobs in (1, 3):
        write_cells(PipelineResults(cells), tmp_path / str(jobs), jobs)

    written = {path.parent.name: path.read_bytes() for path in tmp_path.glob("3/s/*/results.json")}
    assert len(written) == len(cells)
    for path in tmp_path.glob("1/s/*/results.json"):
        assert path.read_bytes() == written[path.parent.name]
    assert read_results(tmp_path / "3/s/seed-7").cells[0].details == Details(iterations=7)


@pytest.mark.parametrize(
    ("cells", "verdict", "code"),
    [
        ((CELL,), "pass", ExitCode.PASS),
        ((CELL, FAILED), "fail", ExitCode.FAIL),
        ((CELL, FAILED, BROKEN), "fail", ExitCode.BAD_INPUT),
        ((BROKEN, replace(BROKEN, error=ExitCode.INFRASTRUCTURE)), "fail", ExitCode.INFRASTRUCTURE),
        ((), "fail", ExitCode.FAIL),
    ],
)
def test_the_verdict_is_red_if_any_cell_is(cells: tuple, verdict: str, code: ExitCode) -> None:  # type: ignore[type-arg]
    assert PipelineResults(cells).verdict == verdict
    assert PipelineResults(cells).exit_code == code


def test_a_comparison_has_no_part_in_the_verdict() -> None:
    assert PipelineResults((CELL,), (replace(BROKEN, method="shah"),)).exit_code == ExitCode.PASS


def test_numbers_over_all_cells() -> None:
    numbers = PipelineResults((CELL, FAILED, replace(CELL, seed=2, rms_px=0.7))).summary

    assert numbers.all.cells == 3
    assert numbers.all.success_rate == pytest.approx(2 / 3, abs=1e-6)
    assert numbers.all.worst_rms_px == 0.7
    assert numbers.systems["robot"].converged == 2


def test_the_table_has_noise_down_and_systems_across() -> None:
    other = replace(CELL, system="other", truth=None)
    table = grid(
        PipelineResults((CELL, FAILED, BROKEN, other), (replace(CELL, method="shah", translation_noise=None),))
    )

    assert table.columns == ("Start", "robot", "other")
    assert table.rows == (
        ("0.5 m, 0 rad", "0.6000 px, 0.5 mm, 0.02 deg", "0.6000 px"),
        ("0.5 m, 0.5 rad", "FAIL: 0/2 pass", "-"),
        ("shah", "0.6000 px, 0.5 mm, 0.02 deg", "-"),
    )


def icp_rows() -> PipelineResults:
    found = replace(CELL, method="icp", rms_px=None, loss=None, start="given", detail="built in")
    lost = replace(found, rotation_noise=0.5, truth=None, converged=False, reasons=("no points near",), detail=None)
    return PipelineResults((CELL, FAILED), (found, lost, replace(lost, seed=2)))


def test_a_method_that_depends_on_the_start_has_a_row_for_each_noise() -> None:
    table = grid(icp_rows())

    assert [row[0] for row in table.rows] == [
        "0.5 m, 0 rad",
        "0.5 m, 0.5 rad",
        "icp, 0.5 m, 0 rad",
        "icp, 0.5 m, 0.5 rad",
    ]
    assert [row[1] for row in table.rows[2:]] == ["0.5 mm, 0.02 deg", "no result"]


def test_a_method_that_depends_on_the_start_is_neither_our_engine_nor_judged(tmp_path: Path) -> None:
    results = icp_rows()
    write_results(results, tmp_path)

    assert without_verdicts(results_of(tmp_path)) == results
    jsonschema.validate(json.loads((tmp_path / "results.json").read_text()), json.loads(SCHEMA_FILE.read_text()))
    rows = list(csv.DictReader((tmp_path / "cells.csv").read_text().splitlines()))
    assert [row["Verdict"] for row in rows] == ["pass", "fail", "", "", ""]
    assert len({row["Cell"] for row in rows}) == 5
    assert "Our engine" not in failures(results)[0]


def test_the_summary_names_the_implementations_of_other_methods() -> None:
    others = [replace(CELL, method=name, detail="OpenCV 4.14.0") for name in ("shah", "li")]
    results = icp_rows()

    text = told(replace(results, comparisons=(*results.comparisons, *others))).markdown()

    assert "- icp on robot: built in\n- shah, li on robot: OpenCV 4.14.0\n" in text
    assert text.count("robot, icp: no points near") == 1


def test_without_a_truth_standard_deviations_are_reported() -> None:
    real = replace(CELL, truth=None, sigma=Deviation(1.03, 0.057), label_sigma=Deviation(0.15, 0.006))
    sure = precision_table(PipelineResults((real, replace(real, seed=2, sigma=Deviation(0.9, 0.06)))))
    assert sure.rows == (("robot", "1.03 mm, 0.06 deg", "0.15 mm, 0.006 deg"),)
    known = replace(real, truth=Deviation(0.5, 0.02))
    assert precision_table(PipelineResults((known,))).rows == ()
    assert "| robot | 1.03 mm, 0.057 deg | 0.15 mm, 0.006 deg |" in told(PipelineResults((real,))).markdown()


def test_errors_are_reported_with_standard_deviations(tmp_path: Path) -> None:
    known = replace(CELL, truth=Deviation(0.5, 0.02), sigma=Deviation(0.4, 0.01, joint_mm=0.2))
    worse = replace(known, seed=2, truth=Deviation(0.3, 0.03), sigma=Deviation(0.6, 0.005))
    software = replace(CELL, system="theirs", method="atom", truth=Deviation(9, 9))
    unknown = replace(CELL, system="unknown", truth=None, sigma=Deviation(9, 9))
    results = PipelineResults((known, worse, software, unknown))

    assert truth_table(results).rows == (("robot", "0.5 mm, 0.03 deg", "0.6 mm, 0.01 deg, joints 0.2 mm"),)
    assert "0.6 mm, 0.01 deg, joints 0.2 mm" in told(results).log()
    assert "± 0.6 mm, 0.01 deg, joints 0.2 mm | 0.5 mm, 0.03 deg" in told(results).markdown()
    assert "Standard deviation" not in told(PipelineResults((software, unknown))).markdown()
    write_results(results, tmp_path)
    document = json.loads((tmp_path / "results.json").read_text())
    jsonschema.validate(document, json.loads(SCHEMA_FILE.read_text()))
    assert document["cells"][0]["sigma"] == {"translation_mm": 0.4, "rotation_deg": 0.01, "joint_mm": 0.2}
    assert without_verdicts(results_of(tmp_path)) == results


def test_of_many_parameters_the_first_are_shown() -> None:
    rows = tuple(ParameterResult("left", f"p{i}", 1.0, "1", 0.1) for i in range(203))
    shown = (
        parameters_table(PipelineResults((replace(CELL, details=Details(intrinsics=rows)),))).markdown().splitlines()
    )

    assert len(shown) == 2 + 201
    assert shown[-1].startswith("| and 3 more, see results.json |")


def test_joints_are_in_the_table_and_in_the_results(tmp_path: Path) -> None:
    both = replace(CELL, truth=Deviation(0.5, 0.02, joint_mm=0.03, joint_deg=0.004))
    turning = replace(CELL, system="turning", truth=Deviation(0.5, 0.02, joint_deg=0.004))
    results = PipelineResults((both, replace(both, seed=2, truth=Deviation(0.5, 0.02, 0.04, 0.001)), turning))

    (row,) = grid(results).rows
    assert row[1:] == (
        "0.6000 px, 0.5 mm, 0.02 deg, joints 0.04 mm, 0.004 deg, 2/2 pass",
        "0.6000 px, 0.5 mm, 0.02 deg, joints 0.004 deg",
    )
    write_results(results, tmp_path)
    document = json.loads((tmp_path / "results.json").read_text())
    jsonschema.validate(document, json.loads(SCHEMA_FILE.read_text()))
    assert document["cells"][0]["truth"] == {
        "translation_mm": 0.5,
        "rotation_deg": 0.02,
        "joint_mm": 0.03,
        "joint_deg": 0.004,
    }
    assert "joint_mm" not in document["cells"][2]["truth"]
    assert [cell.truth for cell in read_results(tmp_path).cells] == [cell.truth for cell in results.cells]


@pytest.mark.parametrize(("count", "widths"), [(1, [2]), (3, [4]), (4, [4, 2]), (7, [4, 4, 2])])
def test_many_systems_take_several_tables(count: int, widths: list[int]) -> None:
    """A method that only one of them has is a row where that one is."""
    cells = tuple(replace(CELL, system=f"robot{k}") for k in range(count))
    whole = grid(PipelineResults(cells, (replace(cells[-1], method="shah", translation_noise=None),)))
    parts = whole.parts()
    assert [len(part.columns) for part in parts] == widths
    assert [name for part in parts for name in part.columns[1:]] == list(whole.columns[1:])
    assert all(part.columns[0] == "Start" for part in parts)
    assert [len(part.rows) for part in parts] == [1] * (len(parts) - 1) + [2]
    assert all(len(row) == len(part.columns) for part in parts for row in part.rows)


def test_a_method_without_a_result_does_not_look_like_a_failure() -> None:
    missing = replace(BROKEN, method="opencv-stereo", translation_noise=None, reasons=("OpenCV is not installed",))

    assert grid(PipelineResults((CELL,), (missing,))).rows[1] == ("opencv-stereo", "no result")
    assert "OpenCV is not installed" in told(PipelineResults((CELL,), (missing,))).markdown()


def test_the_summary_names_what_failed_and_escapes_it() -> None:
    text = told(PipelineResults((CELL, FAILED, BROKEN))).markdown()

    assert told(PipelineResults((CELL, FAILED, BROKEN))).line == "fail: 2 of 3 cells failed"
    assert "robot, 0.5 m, 0.5 rad, seed 1: a false minimum" in text
    assert "<b>" not in text


def test_equal_reasons_of_several_starts_are_merged() -> None:
    def line(*cells: CellResult) -> list[str]:
        return failures(PipelineResults(cells))

    two = (FAILED, replace(FAILED, seed=2))
    other = replace(FAILED, seed=3, reasons=("too far",))
    assert line(*two) == ["robot, all 2 starts: a false minimum"]
    assert line(*two, CELL) == ["robot, 0.5 m, 0.5 rad, seed 1, and 1 more start: a false minimum"]
    assert line(*two, other) == [
        "robot, 0.5 m, 0.5 rad, seed 1, and 1 more start: a false minimum",
        "robot, 0.5 m, 0.5 rad, seed 3: too far",
    ]
    assert line(FAILED, replace(FAILED, system="arm")) == ["robot: a false minimum", "arm: a false minimum"]


def test_each_reason_is_a_line_of_its_own_named_only_among_several_cells() -> None:
    reasons = tuple(f"reason {number}" for number in range(9))
    one = replace(CELL, reasons=reasons)

    assert told(PipelineResults((one,))).reasons == reasons
    assert failures(PipelineResults((one, replace(one, seed=2, reasons=reasons[:1])))) == [
        "robot, all 2 starts: reason 0",
        *(f"robot, 0.5 m, 0 rad, seed 1: {reason}" for reason in reasons[1:]),
    ]
    document = told(PipelineResults((one,)))
    for text in (document.markdown(), document.brief.text if document.brief else ""):
        assert [text.count(reason) for reason in reasons] == [1] * 9


def test_an_undecided_limit_is_a_reason_and_a_warning_after_what_is_red(tmp_path: Path) -> None:
    open_ = CELL.found((Finding("precision", "undecided", "'camera' is not determined well enough"),))
    line = "undecided: 'camera' is not determined well enough"
    for rule, code in ((False, ExitCode.FAIL), (True, ExitCode.PASS)):
        found = told(PipelineResults((replace(open_, undecided_passes=rule),)))
        assert (found.verdict, found.exit_code, found.sentence) == ("undecided", code, "1 of 1 cell undecided")
        assert [(each.level, each.message) for each in found.all_annotations()] == [(Level.WARNING, line)]
        assert found.document["reasons"] == [line]
        [case] = fromstring(found.written()["junit.xml"])[0]
        assert case[0].tag == ("skipped" if rule else "failure")
        assert case[0].get("type") == (None if rule else "undecided")
    red = open_.failing("RMS: found 3")
    assert told(PipelineResults((red,))).all_reasons == ("RMS: found 3", line)
    assert told(PipelineResults((red, replace(open_, seed=2)))).sentence == "1 of 2 cells failed, 1 undecided"


def test_a_failed_cell_does_not_say_that_all_is_well() -> None:
    notes = (
        Finding("nothing-suspicious", "note", "nothing suspicious"),
        Finding("baseline-unmoved", "note", "nothing has moved"),
    )
    well = CELL.found((*notes, Finding("rejected-labels", "note", "3 of 90 labels"), notes[0]))

    assert findings_of(PipelineResults((well,)), "note") == (
        "nothing suspicious",
        "nothing has moved",
        "3 of 90 labels",
    )
    assert findings_of(PipelineResults((well.failing("RMS: found 3"),)), "note") == ("3 of 90 labels",)
    assert len(well.findings) == 3  # each once


def test_the_summary_has_each_warning_once() -> None:
    far = Finding("far-from-description", "warning", "the camera is far off")
    found = (far, Finding("rejected-labels", "note", "3 of 90 labels"))
    warned = CELL.found(found)

    report = told(PipelineResults((warned, replace(warned, seed=2))))

    assert report.warnings == ("the camera is far off",)
    assert [report.markdown().count(each.text) for each in found] == [1, 1]
    assert "3 of 90 labels" in report.log()


def test_a_red_finding_fails_the_cell_whoever_reads_it(tmp_path: Path) -> None:
    far = Finding("far-from-description", "red", "the camera is far off", ("camera",), value=0.3, unit="m")
    red = CELL.found((far,))
    write_results(PipelineResults((red,)), tmp_path)

    read = without_verdicts(results_of(tmp_path))

    assert read.cells[0].verdict == "fail"
    assert read.cells == (red,)
    assert told(read).reasons == ("the camera is far off",)


def test_an_rms_that_is_not_of_the_table_says_so() -> None:
    alone = told(PipelineResults((replace(CELL, table="a/lidar_to_lidar_results.csv"),))).markdown()
    assert "RMS of robot: of all corners" in alone
    assert "lidar\\_to\\_lidar\\_results.csv has none" in alone
    assert "RMS of robot" not in told(PipelineResults((replace(CELL, table="a/rgb_to_rgb_results.csv"),))).markdown()
    software = replace(CELL, method="software", table="a/lidar_to_lidar_results.csv")
    assert "RMS of robot" not in told(PipelineResults((software,))).markdown()


def test_cells_as_a_table_and_as_junit(tmp_path: Path) -> None:
    write_results(PipelineResults((CELL, FAILED, BROKEN)), tmp_path)

    rows = list(csv.DictReader((tmp_path / "cells.csv").read_text().splitlines()))
    assert [row["Verdict"] for row in rows] == ["pass", "fail", "fail"]
    assert rows[0]["Trans error (mm)"] == "0.5000"
    suite = fromstring((tmp_path / "junit.xml").read_text())
    assert len(suite.findall(".//testcase")) == 3
    assert len(suite.findall(".//failure")) == 1
    assert len(suite.findall(".//error")) == 1


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"cells": 1, "comparisons": []}', '{"cells": [1], "comparisons": []}']
)
def test_no_results_are_bad_input(tmp_path: Path, text: str) -> None:
    (tmp_path / "results.json").write_text(text)

    with pytest.raises(InputError, match=r"results\.json"):
        read_results(tmp_path)


def test_missing_results_are_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="results of calibrate-matrix or run was expected, but it cannot be read"):
        read_results(tmp_path)


def test_what_an_earlier_matrix_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    found = run_matrix(Matrix((replace(RIWBOT, compare=("shah",)),), NoiseGrid()), tmp_path / "output", 1)
    write_results(PipelineResults(found.cells, found.comparisons), tmp_path / "output")
    (tmp_path / "output" / "notes.txt").write_text("mine")

    clear_results(tmp_path / "output")

    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["notes.txt"]


def test_no_path_in_results_reaches_out_of_the_folder(tmp_path: Path) -> None:
    precious = tmp_path / "precious.csv"
    precious.write_text("1")
    output = tmp_path / "output"
    write_results(
        PipelineResults((replace(CELL, table="../precious.csv"), replace(CELL, seed=2, table=str(precious)))), output
    )

    clear_results(output)

    assert precious.exists()
    assert not (output / "results.json").exists()


def test_an_input_among_the_earlier_results_is_not_removed(tmp_path: Path) -> None:
    found = run_matrix(Matrix((RIWBOT,), NoiseGrid()), tmp_path, 1)
    write_results(PipelineResults(found.cells), tmp_path)
    assert found.cells[0].dataset is not None
    dataset = tmp_path / found.cells[0].dataset

    with pytest.raises(InputError, match="choose another output"):
        clear_results(tmp_path, [dataset])

    assert dataset.exists()


def software_cells(reference_passes: bool) -> PipelineResults:
    theirs = replace(CELL, method="software", loss=None, start="given", rms_px=3.0, reasons=("RMS: found 3",))
    ours = replace(CELL, rms_px=0.5, reasons=() if reference_passes else ("RMS: found 2.5",))
    return PipelineResults((theirs,), (ours, replace(CELL, method="shah", translation_noise=None, rotation_noise=None)))


def test_the_team_s_software_and_our_engine_side_by_side() -> None:
    table = grid(software_cells(True))
    system = CELL.system
    assert table.columns == ("Start", f"{system}: software", f"{system}: calibration-ci")
    start, other = table.rows
    assert start[1].startswith("3.0000 px")
    assert start[1].endswith("FAIL")
    assert start[2].startswith("0.5000 px")
    assert "FAIL" not in start[2]
    assert other[:2] == ("shah", "-")
    assert len(table.rows) == 2


def test_whose_fault_it_is() -> None:
    passes = "our engine passes on the same data from the same start (0.5000 px): look at the software"
    assert failures(software_cells(True))[-1] == passes
    fails = "our engine fails on the same data too (RMS: found 2.5): look at the data"
    assert failures(software_cells(False))[-1] == fails
    assert "Methods without a result" not in told(software_cells(False)).markdown()
    died = software_cells(True)
    died = replace(
        died, cells=(replace(died.cells[0], reasons=("the engine is gone",), error=ExitCode.INFRASTRUCTURE),)
    )
    [line] = failures(died)
    assert line == "the engine is gone"  # which is not the software's fault


def test_our_engine_beside_the_software_has_no_part_in_the_verdict() -> None:
    results = software_cells(False)
    passing = replace(results, cells=(replace(results.cells[0], reasons=()),))
    assert (results.verdict, passing.verdict) == ("fail", "pass")


def test_the_image_is_part_of_the_results(tmp_path: Path) -> None:
    image = ImageResult("team/robot:key-1", "1" * 64, False, "sha256:2", 0.5, ("stable",))
    results = PipelineResults((CELL,), image=image)
    write_results(results, tmp_path)
    jsonschema.validate(json.loads((tmp_path / "results.json").read_text()), json.loads(SCHEMA_FILE.read_text()))
    assert read_results(tmp_path).image == image
    assert "Image team/robot:key-1: unchanged, nothing was built; promoted to stable\n" in told(results).markdown()


def test_only_an_image_is_a_pass_and_nothing_at_all_is_none() -> None:
    assert (
        told(PipelineResults((), image=ImageResult("team/robot:key-1", "1" * 64, True))).line
        == "pass: the image is built"
    )
    assert told(PipelineResults()).line == "fail: 0 of 0 cells failed"
