"""Results of a workflow's jobs, compared with the plan."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calibration.base import ExitCode, InputError
from calibration.pipeline.gathering import NO_RESULT, Gathered, Needs
from calibration.pipeline.gathering import gather as gather_by_needs
from calibration.pipeline.matrix.cell_result import CellResult
from calibration.pipeline.matrix.matrix import Matrix, run_matrix
from calibration.pipeline.report import write_results
from calibration.pipeline.results import Collected, ImageResult, PipelineResults
from calibration.pipeline.system import NoiseGrid
from calibration.pipeline.workflow_plan import JobCell, WorkflowPlan
from tests.pipeline.conftest import RIWBOT
from tests.pipeline.matrix.test_cell_verdict import CELL

ONE = JobCell("robot, 0.5 m, 0.3 rad", "one", "robot", (0.5,), (0.3,))
TWO = JobCell("robot, 0 m, 0.3 rad", "two", "robot", (0.0,), (0.3,))
LATER = JobCell("fresh", "later", "fresh", (0.0,), (0.0,), image="built", collected=True)
FRESH = Collected("fresh", poses=4, kept=4, dataset="collected/fresh")
BOTH = WorkflowPlan((ONE, TWO))
WHOLE = WorkflowPlan((ONE, TWO, LATER), simulations=("fresh",), unit_tests=True, image=True, push=True)


def result(job: JobCell, seed: int = 1, **changes: Any) -> CellResult:
    base = replace(
        CELL,
        system=job.system,
        translation_noise=job.translations[0],
        rotation_noise=job.rotations[0],
        seed=seed,
        converged=True,
        reasons=(),
        error=None,
        table="robot/table.csv",
        dataset=None,
    )
    return replace(base, **changes)


def needs(plan: WorkflowPlan, **results: str) -> Needs:
    found = {job: "success" if runs else "skipped" for job, runs in plan.jobs.items()}
    found |= {job.replace("_", "-"): outcome for job, outcome in results.items()}
    return Needs({"plan": "success", **found})


def gather(plan: WorkflowPlan, folder: Path, **results: str) -> Gathered:
    """Gather a plan's results; its jobs have succeeded unless told otherwise."""
    return gather_by_needs(needs(plan, **results), plan, folder)


@pytest.fixture
def leave(tmp_path: Path) -> Callable[..., Path]:
    """Return what a job does: leave its results in a folder of its own."""

    def write(slug: str, *cells: CellResult, **others: Any) -> Path:
        write_results(PipelineResults(cells, **others), tmp_path / slug)
        return tmp_path / slug / "results.json"

    return write


def test_everything_that_was_planned_is_there(leave: Callable[..., Path], tmp_path: Path) -> None:
    image = ImageResult("ghcr.io/me/robot:key-1", "1", True)
    shah = result(ONE, method="shah", translation_noise=None, rotation_noise=None, seed=None, start=None, loss=None)
    ours = [result(job, dataset="a/dataset.json") for job in (ONE, TWO)]
    for job, slug, our in ((ONE, "one", ours[0]), (TWO, "two", ours[1])):
        leave(slug, result(job), comparisons=(our, shah))
    leave("later", result(LATER))
    leave("collected-data", collections=(FRESH,), image=image)

    found = gather(WHOLE, tmp_path)

    assert found.exit_code == ExitCode.PASS
    assert found.problems == ()
    assert [(cell.system, cell.translation_noise) for cell in found.results.cells] == [
        ("robot", 0.5),
        ("robot", 0.0),
        ("fresh", 0.0),
    ]
    assert [str(cell.table).partition("/")[::2] for cell in found.results.cells] == [
        (slug, "robot/table.csv") for slug in ("one", "two", "later")
    ]
    assert [cell.method for cell in found.results.comparisons] == ["calibration-ci", "shah", "calibration-ci"]
    assert found.results.collections == (replace(FRESH, dataset="collected-data/collected/fresh"),)
    assert found.results.image == image
    assert set(found.jobs) == {
        "plan",
        "image",
        "calibrate",
        "collect-data",
        "calibrate-collected-in-image",
        "unit-tests",
    }


def test_real_results_are_gathered_unchanged(tmp_path: Path) -> None:
    """Two jobs and the same matrix in one piece give the same results, up to where the files are."""
    matrix = Matrix((replace(RIWBOT, compare=("shah",)),), NoiseGrid((0.0, 0.5), (0.3,)))
    whole = run_matrix(matrix, tmp_path / "whole", 1)
    for slug, t in (("a", 0.0), ("b", 0.5)):
        part = run_matrix(replace(matrix, noise=NoiseGrid((t,), (0.3,))), tmp_path / slug, 1)
        write_results(PipelineResults(part.cells, part.comparisons), tmp_path / slug)
    jobs = (JobCell("", "a", "riwbot", (0.0,), (0.3,)), JobCell("", "b", "riwbot", (0.5,), (0.3,)))

    found = gather(WorkflowPlan(jobs), tmp_path).results

    def essence(cells: tuple[CellResult, ...]) -> list[CellResult]:
        return [replace(cell, details=None, seconds=0, table=None, dataset=None, folder=None) for cell in cells]

    assert essence(found.cells) == essence(whole.cells)
    assert essence(found.comparisons) == essence(whole.comparisons)
    for cell in (*found.cells, *found.comparisons):
        assert (tmp_path / str(cell.table)).is_file()
        assert (tmp_path / str(cell.dataset)).is_file()
        assert (tmp_path / str(cell.folder)).is_dir()


def test_a_cell_that_failed_explains_its_job(leave: Callable[..., Path], tmp_path: Path) -> None:
    leave("one", result(ONE))
    leave("two", result(TWO, reasons=("RMS: found 9 px",)))
    found = gather(BOTH, tmp_path, calibrate="failure")
    assert found.exit_code == ExitCode.FAIL
    assert found.problems == ()
    assert found.jobs == {"plan": "success", "calibrate": "failure"}


@pytest.mark.parametrize("job", ["success", "failure", "cancelled", "skipped"])
def test_a_missing_result_is_never_a_pass(job: str, leave: Callable[..., Path], tmp_path: Path) -> None:
    leave("one", result(ONE))
    found = gather(BOTH, tmp_path, calibrate=job)
    assert found.exit_code == ExitCode.INFRASTRUCTURE
    assert [cell.reasons for cell in found.results.cells] == [(), (NO_RESULT,)]


def test_a_missing_seed_is_a_missing_result(leave: Callable[..., Path], tmp_path: Path) -> None:
    leave("one", result(ONE, 1))
    found = gather(WorkflowPlan((ONE,), seeds=(1, 2)), tmp_path)
    assert [(cell.seed, cell.verdict) for cell in found.results.cells] == [(1, "pass"), (2, "fail")]


def test_nothing_at_all_is_left(tmp_path: Path) -> None:
    found = gather(WHOLE, tmp_path / "nowhere", image="failure", calibrate="skipped")
    assert found.exit_code == ExitCode.INFRASTRUCTURE
    assert all(cell.reasons == (NO_RESULT,) for cell in found.results.cells)
    assert [cell.method for cell in found.results.cells] == ["calibration-ci", "calibration-ci", "software"]
    assert found.results.collections == (Collected("fresh", reasons=(NO_RESULT,), error=ExitCode.INFRASTRUCTURE),)
    assert found.problems == ("the job image failed: see its log",)


@pytest.mark.parametrize(
    ("results", "problem"),
    [
        ({"calibrate": "failure"}, "the job calibrate failed: see its log"),
        ({"calibrate": "cancelled"}, "the job calibrate was cancelled: see its log"),
        ({"calibrate-collected-in-image": "failure"}, "the job calibrate-collected-in-image failed: see its log"),
        ({"collect-data": "skipped"}, "the job collect-data did not run: see its log"),
        ({"unit-tests": "failure"}, "the job unit-tests failed: see its log"),
        ({"unit-tests": "missing"}, "the job unit-tests is missing: see its log"),
        ({"image": "cancelled"}, "the job image was cancelled: see its log"),
    ],
)
def test_a_job_that_failed_though_its_results_are_fine_is_red(
    results: dict[str, str], problem: str, leave: Callable[..., Path], tmp_path: Path
) -> None:
    for slug, job in (("one", ONE), ("two", TWO), ("later", LATER)):
        leave(slug, result(job))
    leave("collected-data", collections=(FRESH,))
    found = gather(WHOLE, tmp_path, **results)
    assert found.problems == (problem,)
    assert found.exit_code == ExitCode.FAIL


def test_an_unplanned_job_that_failed_is_red(leave: Callable[..., Path], tmp_path: Path) -> None:
    leave("one", result(ONE))
    known = Needs({"plan": "success", "calibrate": "success"})
    found = gather_by_needs(known, WorkflowPlan((ONE,), unit_tests=True), tmp_path)
    assert found.problems == ("the job unit-tests is missing: see its log",)


def test_a_failed_job_is_not_hidden_by_a_failed_cell_of_another(leave: Callable[..., Path], tmp_path: Path) -> None:
    leave("one", result(ONE, reasons=("RMS: found 9 px",)))
    leave("two", result(TWO))
    leave("later", result(LATER))
    leave("collected-data", collections=(FRESH,))
    found = gather(WHOLE, tmp_path, calibrate="failure", calibrate_collected_in_image="failure")
    assert found.problems == ("the job calibrate-collected-in-image failed: see its log",)


@pytest.mark.parametrize("outcome", ["failure", "cancelled", "skipped"])
def test_a_plan_that_failed_is_red(outcome: str, tmp_path: Path) -> None:
    found = gather_by_needs(Needs({"plan": outcome}), None, tmp_path)
    assert found.exit_code == ExitCode.FAIL
    assert len(found.problems) == 1


def test_only_unit_tests(tmp_path: Path) -> None:
    plan = WorkflowPlan(unit_tests=True)
    assert gather(plan, tmp_path).exit_code == ExitCode.PASS
    assert gather(plan, tmp_path, unit_tests="failure").exit_code == ExitCode.FAIL


@pytest.mark.parametrize(("outcome", "problems"), [("success", 0), ("skipped", 0), ("failure", 1), ("cancelled", 1)])
def test_an_upload_that_failed_is_red(outcome: str, problems: int, tmp_path: Path) -> None:
    found = gather(WorkflowPlan(unit_tests=True), tmp_path, coverage=outcome)
    assert len(found.problems) == problems
    assert ("coverage" in found.jobs) is (outcome != "skipped")
    assert found.exit_code == (ExitCode.FAIL if problems else ExitCode.PASS)


def test_what_was_not_planned_is_refused(leave: Callable[..., Path], tmp_path: Path) -> None:
    leave("one", result(ONE), result(TWO))
    with pytest.raises(InputError, match=r"one/results.json: has a result of robot, 0 m, .* which was not"):
        gather(WorkflowPlan((ONE,)), tmp_path)
    leave("collected-data", collections=(FRESH, replace(FRESH, name="more")))
    with pytest.raises(InputError, match=r"collected-data/results.json: has more, which was not planned"):
        gather(WorkflowPlan(simulations=("fresh",)), tmp_path)


def edited(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["cells"][0].update(verdict="pass"), "found pass, which its own numbers and reasons contradict"),
        (lambda d: d["cells"][0].update(rms_px=float("nan")), "found NaN, a finite number was expected"),
        (lambda d: d["cells"][0].pop("converged"), r"cells\.0.*converged"),
        (lambda d: d.update(schema=2), "schema: found 2, expected 1"),
        (lambda d: d["cells"][0].update(rms_px="good"), r"cells\.0\.rms_px: found 'good', expected a number"),
        (lambda d: d["cells"][0].update(error=7), r"cells\.0\.error: found 7, expected"),
        (lambda d: d.update(cells={}), "cells: found an empty mapping, expected a list"),
        (lambda d: d.pop("cells"), "it has no list of cells"),
    ],
)
def test_a_results_file_is_checked_by_its_schema(
    change: Callable[[dict[str, Any]], object], message: str, leave: Callable[..., Path], tmp_path: Path
) -> None:
    edited(leave("one", result(ONE, reasons=("too far off",))), change)
    with pytest.raises(InputError, match=message):
        gather(WorkflowPlan((ONE,)), tmp_path)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "\xff"])
def test_what_is_no_results_file(text: str, tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "results.json").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=r"one/results.json: this is no JSON"):
        gather(WorkflowPlan((ONE,)), tmp_path)


def test_what_a_job_says_of_others_does_not_count(leave: Callable[..., Path], tmp_path: Path) -> None:
    """Code of the repository has run in the jobs, and may have written what it liked into their results."""
    other = result(replace(ONE, system="another robot"))
    leave("one", result(ONE), comparisons=(other,), collections=(FRESH,), image=ImageResult("evil", "1", True))
    leave("unit-tests", result(ONE, rms_px=0.0))
    found = gather(WorkflowPlan((ONE,), unit_tests=True), tmp_path).results
    assert (found.comparisons, found.collections, found.image) == ((), (), None)
    assert found.cells == gather(WorkflowPlan((ONE,)), tmp_path).results.cells


def test_the_error_of_a_job_without_results_is_a_reason(tmp_path: Path) -> None:
    known = replace(needs(WHOLE, image="failure"), errors={"image": "ghcr.io/me/robot: denied\nby ghcr.io"})
    [problem] = gather_by_needs(known, WHOLE, tmp_path).problems
    assert problem.startswith("image: ghcr.io/me/robot: denied")
    assert "\n" not in problem
