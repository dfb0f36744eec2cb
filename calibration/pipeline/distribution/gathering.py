"""What the jobs of a workflow left, as one set of results with one verdict."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from calibration.errors import ExitCode, InputError
from calibration.files import read_bytes
from calibration.json_file import parse_json
from calibration.json_schema import check_document
from calibration.pipeline.collection.collected import Collected
from calibration.pipeline.distribution.needs import SUCCESS, Needs
from calibration.pipeline.distribution.plan import COLLECTED_DATA, JobCell, Plan
from calibration.pipeline.distribution.plan_outputs import plan_of_outputs
from calibration.pipeline.image_result import ImageResult
from calibration.pipeline.matrix.cell import OUR_METHOD, Cell, CellResult, Deviation, nothing_yet
from calibration.pipeline.matrix.software import SOFTWARE
from calibration.pipeline.results import FILE, SCHEMA, Results

MOST_BYTES = 64 * 1024**2
"""The largest results file that is read."""
NO_RESULT = "its job left no result: see the job's log"


@dataclass(frozen=True)
class Gathered:
    """All that a run of the workflow found."""

    results: Results
    jobs: Mapping[str, str]
    """What became of each job that was to run."""
    problems: tuple[str, ...] = ()
    """Jobs that did not succeed, where no result says why."""
    plan: Plan = field(default_factory=Plan)
    """Empty where planning failed."""

    @property
    def exit_code(self) -> ExitCode:
        """Pass when every job succeeded and everything that was planned has passed."""
        found = self.results.exit_code if self.results.judged else ExitCode.PASS
        return max(found, ExitCode.FAIL) if self.problems else found


def gather(needs: Needs, folder: Path) -> Gathered:
    """Read what the jobs left below a folder, each in a folder with its slug, and hold it against the plan.

    What was planned and is not there fails.

    Raises:
        InputError: a file is no results file, or has what was not planned.
    """
    if needs.results["plan"] != SUCCESS:
        return Gathered(Results(()), {"plan": needs.results["plan"]}, (_problem("plan", needs.results["plan"]),))
    plan = plan_of_outputs(needs.plan)
    jobs = {"plan": SUCCESS} | {job: needs.results.get(job, "missing") for job, runs in plan.jobs.items() if runs}
    jobs |= {job: result for job, result in needs.unplanned.items() if result != "skipped"}
    parts = [_cells_of(cell, plan, folder) for cell in plan.cells]
    collected = _collections_of(plan, folder)
    results = Results(
        tuple(cell for part in parts for cell in part.cells),
        _each_once(other for part in parts for other in part.comparisons),
        collected.collections,
        collected.image,
    )
    failed = {
        "calibrate": _any_failed(zip(plan.cells, parts, strict=True), collected=False),
        "calibrate-collected": _any_failed(zip(plan.cells, parts, strict=True), collected=True),
        "collect-data": any(each.verdict == "fail" for each in results.collections),
    }
    problems = [_problem(job, result) for job, result in jobs.items() if result != SUCCESS and not failed.get(job)]
    return Gathered(results, jobs, tuple(problems), plan)


def _any_failed(parts: Iterable[tuple[JobCell, Results]], *, collected: bool) -> bool:
    return any(found.verdict == "fail" for cell, part in parts if cell.collected is collected for found in part.cells)


def _problem(job: str, result: str) -> str:
    what = {"failure": "failed", "cancelled": "was cancelled", "skipped": "did not run"}.get(result, f"is {result}")
    return f"the job {job} {what}: see its log"


def _cells_of(job: JobCell, plan: Plan, folder: Path) -> Results:
    """The results of one job of the matrix, in the order of the plan; what is missing has failed."""
    found = _read(folder / job.slug)
    by_start = {cell.start_of_cell: cell for cell in found.cells}
    planned = {_start(cell): cell for cell in job.starts(plan.seeds)}
    cells = [by_start.get(start) or _missing(cell, job) for start, cell in planned.items()]
    if other := by_start.keys() - planned.keys():
        name = by_start[min(other, key=str)].name
        raise InputError(f"{folder / job.slug / FILE}: has a result of {name}, which was not planned for this job")
    return replace(found, cells=tuple(cells))


def _start(cell: Cell) -> tuple[str, float, float, int]:
    return (cell.system, cell.noise.translation, cell.noise.rotation, cell.noise.seed)


def _missing(cell: Cell, job: JobCell) -> CellResult:
    result = nothing_yet(cell, SOFTWARE if job.image else OUR_METHOD)
    return replace(result.failing(NO_RESULT), error=ExitCode.WORLD)


def _collections_of(plan: Plan, folder: Path) -> Results:
    if not plan.simulations:
        return Results(())
    found = _read(folder / COLLECTED_DATA)
    by_name = {each.name: each for each in found.collections}
    collections = [
        by_name.get(name) or Collected(name, reasons=(NO_RESULT,), error=ExitCode.WORLD) for name in plan.simulations
    ]
    if other := by_name.keys() - set(plan.simulations):
        raise InputError(f"{folder / COLLECTED_DATA / FILE}: has {min(other)}, which was not planned")
    return replace(found, collections=tuple(collections))


def _each_once(comparisons: Iterable[CellResult]) -> tuple[CellResult, ...]:
    """The comparisons, of which those that take no start were made by every job of their system."""
    return tuple({(cell.start_of_cell, cell.method): cell for cell in comparisons}.values())


def _read(folder: Path) -> Results:
    """The results in a folder, with their verdicts; nothing where there is no file.

    Raises:
        InputError: the file is no results file.
    """
    path = folder / FILE
    if not path.exists():
        return Results(())
    try:
        document = parse_json(read_bytes(path, MOST_BYTES, "a results file"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: this is not a results file: {error}") from None
    check_document(document, json.loads(SCHEMA.read_text()), str(path), {})
    try:
        return Results(
            tuple(_result(entry, folder.name, path) for entry in document["cells"]),
            tuple(_result(entry, folder.name, path) for entry in document["comparisons"]),
            tuple(_collected(entry, folder.name) for entry in document["collections"]),
            ImageResult.of_document(document["image"]) if document["image"] else None,
        )
    except (KeyError, TypeError) as error:  # a field that this version does not know
        raise InputError(f"{path}: these are not results of this version: {error}") from None


def _result(entry: Mapping[str, Any], slug: str, path: Path) -> CellResult:
    result = CellResult(
        system=entry["system"],
        method=entry["method"],
        translation_noise=entry["translation_noise"],
        rotation_noise=entry["rotation_noise"],
        seed=entry["seed"],
        start=entry["start"],
        loss=entry.get("loss"),
        converged=entry["converged"],
        rms_px=entry["rms_px"],
        table=_below(slug, entry["table"]),
        dataset=_below(slug, entry["dataset"]),
        truth=Deviation(**entry["truth"]) if entry["truth"] else None,
        sigma=Deviation(**entry["sigma"]) if entry["sigma"] else None,
        seconds=entry["seconds"],
        reasons=tuple(entry["reasons"]),
        error=None if entry["error"] is None else ExitCode(entry["error"]),
        warnings=tuple(entry["warnings"]),
        detail=entry["detail"],
    )
    if result.verdict != entry["verdict"]:
        raise InputError(f"{path}: {result.name}: says {entry['verdict']}, which its own numbers and reasons deny")
    return result


def _collected(entry: dict[str, Any], slug: str) -> Collected:
    return replace(Collected.of_document(entry), dataset=_below(slug, entry["dataset"]))


def _below(slug: str, path: str | None) -> str | None:
    return None if path is None else f"{slug}/{path}"
