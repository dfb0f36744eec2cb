"""Results of a workflow's jobs as one set with one verdict, their durations as they report them, and their cost."""

import json
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from dataclasses import field as dataclass_field
from pathlib import Path
from typing import Any

from calibration.base import CalibrationError, ExitCode, InputError, brief, number_text, one_line, read_bytes
from calibration.base.records import computed, field, result
from calibration.ci.report import RESULTS_FILE, Lines, Report, Table, Text, Verdict, reasons_in, verdict_of
from calibration.ci.report.blocks import BADGE_FILE as BADGE
from calibration.ci.report.blocks import verdict_badge
from calibration.ci.report.report import BRIEF_FILE, Brief, StageResult, read_brief
from calibration.pipeline.containers import SOFTWARE_METHOD
from calibration.pipeline.matrix.cell_result import OUR_METHOD, Cell, CellResult, nothing_yet
from calibration.pipeline.report import report
from calibration.pipeline.results import (
    CELLS_FILE,
    Collected,
    PipelineResults,
    StageResults,
    own_details,
    own_file,
    read_results,
)
from calibration.pipeline.workflow_plan import COLLECTED_DATA, STAGE_OF_JOB, JobCell, WorkflowPlan

JOB_SUCCESS = "success"
UNPLANNED_JOBS = ("check", "coverage")
"""Jobs that plan-matrix does not plan, as other inputs of the workflow control them."""
SECONDS_OUTPUT = "seconds"
"""Output with the duration, of a job without a matrix."""
ERROR_OUTPUT = "error"
"""Output with the line of an error (`calibration.ci.workflow`), of a job that leaves no results."""
SECONDS_FILE = "job-seconds.txt"
"""File with the duration, beside the results of a job of the matrix, whose outputs GitHub does not keep one by one."""
_SECONDS_PATTERN = re.compile(r"[0-9]{1,7}")
"""Durations of up to 115 days."""


@dataclass(frozen=True)
class Needs:
    """Results of the previous jobs."""

    results: Mapping[str, str] = dataclass_field(default_factory=dict)
    """Result of each job: success, failure, cancelled or skipped."""
    seconds: Mapping[str, int] = dataclass_field(default_factory=dict)
    """Durations of the jobs that report them by an output."""
    errors: Mapping[str, str] = dataclass_field(default_factory=dict)
    """Error lines of the jobs that leave no results, and report them by an output."""

    @property
    def unplanned(self) -> dict[str, str]:
        """Results of the jobs that are not in the plan."""
        return {job: self.results[job] for job in UNPLANNED_JOBS if job in self.results}


def parse_needs(text: str) -> Needs:
    """Parse the JSON of the previous jobs: an object with the result of each, and with its outputs seconds and error.

    Raises:
        InputError: it is invalid, or has no job plan.
    """
    try:
        jobs = json.loads(text)
        results = {name: str(job["result"]) for name, job in jobs.items()}
        seconds = {
            name: found for name, job in jobs.items() if (found := parse_seconds(job.get(SECONDS_OUTPUT))) is not None
        }
        errors = {name: str(job[ERROR_OUTPUT]) for name, job in jobs.items() if job.get(ERROR_OUTPUT)}
        _ = results["plan"]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise InputError(
            'needs: an object with every job was expected, {"plan": {"result": "success", "seconds": "7"}, ...}'
        ) from None
    return Needs(results, seconds, errors)


def parse_seconds(value: object) -> int | None:
    """Parse the seconds that a job reports; None if invalid, which is not an error."""
    text = value.strip() if isinstance(value, str) else ""
    return int(text) if _SECONDS_PATTERN.fullmatch(text) else None


def read_seconds(folder: Path) -> int | None:
    """Read the duration in a job's folder; None if it is missing or invalid."""
    try:
        return parse_seconds(read_bytes(folder / SECONDS_FILE, 16, "a number of seconds").decode("latin-1"))
    except CalibrationError:
        return None


VERDICT_JOB, PROMOTE_JOB = "verdict", "promote"
"""The last jobs: the one that computes the cost, and the one that runs after it."""
MONEY_DECIMALS = 6
"""Decimals of an amount of money; further ones are rounding errors."""


@result
class JobTime:
    """Time of one job."""

    job: str = field("Its place in the workflow: calibrate.")
    name: str = field("Its cell (robot, 0.5 m, 0 rad); the job's name if there is only one.")
    seconds: int | None = field("Null if unknown: the job was lost or cancelled, or has not run.", default=None)

    @property
    @computed("billed_minutes")
    def minutes(self) -> int | None:
        """Billed time: started minutes, at least one."""
        return None if self.seconds is None else max(1, -(-self.seconds // 60))


@result
class Cost:
    """Times of the jobs of a run, or some of them."""

    times: tuple[JobTime, ...] = field("The jobs.", key="jobs")
    rate: float | None = field("Cost of a minute, in any currency; null if not given.", default=None)

    @property
    @computed()
    def complete(self) -> bool:
        """Whether the time of every job is known, and so in the sum."""
        return len(self.known) == len(self.times)

    @property
    def known(self) -> tuple[JobTime, ...]:
        """The jobs whose time is known."""
        return tuple(time for time in self.times if time.seconds is not None)

    @property
    def seconds(self) -> int:
        """Sum of the known times."""
        return sum(time.seconds or 0 for time in self.times)

    @property
    @computed("billed_minutes")
    def minutes(self) -> int:
        """Billed minutes of the known times."""
        return sum(time.minutes or 0 for time in self.times)

    @property
    @computed("cost")
    def amount(self) -> float | None:
        """Cost of these minutes; None without a rate."""
        return None if self.rate is None else round(self.minutes * self.rate, MONEY_DECIMALS)

    def of(self, job: str) -> "Cost":
        """Return the part of one job of the workflow."""
        return Cost(tuple(time for time in self.times if time.job == job), self.rate)

    @property
    def sentence(self) -> str:
        """The sum in one line."""
        least = "" if self.complete else "at least "
        price = "" if self.rate is None else f": {money(self.amount)} at {number_text(self.rate)} a minute"
        return f"{least}{self.minutes} billed minutes{price}"


def cost_of_run(plan: WorkflowPlan, needs: Needs, folder: Path, seconds: int | None, *, promotes: bool) -> Cost:
    """Return the cost of a run, as far as its jobs have reported their times.

    Args:
        plan: of the run; empty if planning failed.
        needs: results of the jobs before this one.
        folder: their files, each in a folder with its slug.
        seconds: of the current job, until now.
        promotes: whether a job runs after it.
    """
    times = []
    for job in ("plan", *plan.jobs, *needs.unplanned):  # not in the order of needs, whose keys act sorts by name
        if needs.results.get(job, "skipped") == "skipped":
            continue
        cells = plan.cells_of_job.get(job)
        if cells is None:
            times.append(JobTime(job, job, needs.seconds.get(job)))
        else:
            times += [JobTime(job, cell.name, read_seconds(folder / cell.slug)) for cell in cells]
    times.append(JobTime(VERDICT_JOB, VERDICT_JOB, seconds))
    if promotes:
        times.append(JobTime(PROMOTE_JOB, PROMOTE_JOB))
    return Cost(tuple(times), plan.minute_rate)


def jobs_table(results: Mapping[str, str], cost: Cost) -> Table:
    """Return the table of all jobs: result, time and cost of each."""
    results = {**results, VERDICT_JOB: "this job", **({PROMOTE_JOB: "to come"} if cost.of(PROMOTE_JOB).times else {})}
    rows = [(job, result, *_cost_numbers(cost.of(job))) for job, result in results.items()]
    header: tuple[str, ...] = ("Job", "Result", "Jobs", "Seconds", "Billed minutes")
    sums = ("all", "", *_cost_numbers(cost))
    if cost.rate is None:
        return Table(header, tuple(row[:-1] for row in (*rows, sums)), title="Jobs", only="summary")
    header = (*header, f"Cost at {number_text(cost.rate)} a minute")
    return Table(header, (*rows, sums), title="Jobs", only="summary")


def money(amount: float | None) -> str:
    """Format an amount with all its digits; empty if there is none."""
    return "" if amount is None else f"{amount:.{MONEY_DECIMALS}f}".rstrip("0").rstrip(".")


def _cost_numbers(cost: Cost) -> tuple[str, str, str, str]:
    """Format jobs, seconds, minutes and money; with "+ ?" if some are unknown."""
    count = str(len(cost.times))
    if cost.times and not cost.known:
        return (count, "?", "?", "?")
    more = "" if cost.complete else " + ?"
    return (count, f"{cost.seconds}{more}", f"{cost.minutes}{more}", f"{money(cost.amount)}{more}")


NO_RESULT = "its job left no result: see the job's log"


@result
class RunResults(PipelineResults):
    """Results of a pipeline, with the times of the workflow's jobs."""

    cost: Cost | None = field("Times of a workflow's jobs; only in its gathered results.", default=None, omitted=True)


@dataclass(frozen=True)
class Gathered:
    """Results of all jobs of a workflow run."""

    results: PipelineResults
    jobs: Mapping[str, str]
    """Result of each planned job."""
    problems: tuple[str, ...] = ()
    """Jobs that did not succeed, without results that give the reason."""
    plan: WorkflowPlan = dataclass_field(default_factory=WorkflowPlan)
    """Empty if planning failed."""
    lines_of_jobs: tuple[str, ...] = ()
    """What jobs beside the calibration say in brief: tests, coverage of the change."""

    @property
    def verdict(self) -> Verdict:
        """Fail if a job or a cell failed, else undecided if a cell is."""
        undecided = self.results.has_verdict and self.results.verdict == "undecided" and not self.problems
        return "undecided" if undecided else verdict_of(self.exit_code == ExitCode.PASS)

    @property
    def exit_code(self) -> ExitCode:
        """Pass if every job succeeded and every planned cell passed."""
        found = self.results.exit_code if self.results.has_verdict else ExitCode.PASS
        return max(found, ExitCode.FAIL) if self.problems else found


def gather(needs: Needs, plan: WorkflowPlan | None, folder: Path) -> Gathered:
    """Read the files of the jobs below a folder, each in a folder with its slug, and compare them with the plan.

    Of each job only what it was planned to do counts, as code of the repository may have written its files. Planned
    results that are missing fail.

    Args:
        needs: results of the jobs.
        plan: their plan; None if planning failed.
        folder: their files.

    Raises:
        InputError: a file is not a results file, or has unplanned cells.
    """
    if plan is None:
        return Gathered(PipelineResults(), {"plan": needs.results["plan"]}, _reasons_of_job("plan", needs, folder))
    jobs = {"plan": JOB_SUCCESS} | {job: needs.results.get(job, "missing") for job, runs in plan.jobs.items() if runs}
    jobs |= {job: result for job, result in needs.unplanned.items() if result != "skipped"}
    parts = [_cells_of(cell, plan, folder) for cell in plan.cells]
    collected = _collections_of(plan, folder)
    of_stages = {job: found for job in plan.stages if (found := _stage_result(job, folder)) is not None}
    results = PipelineResults(
        tuple(cell for part in parts for cell in part.cells),
        # those without an initial guess are in every job of their system
        tuple({(each.start_of_cell, each.method): each for part in parts for each in part.comparisons}.values()),
        collected.collections,
        collected.image,
        next((part.baseline for part in parts if part.baseline is not None), None),
        tuple({each.system: each for part in parts for each in part.exports}.values()),
        StageResults(**{STAGE_OF_JOB[job].section: found for job, found in of_stages.items()}),
        next((part.commit for part in parts if part.commit is not None), None),
    )
    failed = {
        cell.job for cell, part in zip(plan.cells, parts, strict=True) if not all(found.passes for found in part.cells)
    }
    if any(each.verdict == "fail" for each in results.collections):
        failed |= {job for job in jobs if job.startswith("collect-data")}
    failed |= {job for job, found in of_stages.items() if found.reasons}
    lost = [job for job, result in jobs.items() if result != JOB_SUCCESS and job not in failed]
    lost += [job for job in plan.stages if jobs[job] == JOB_SUCCESS and job not in of_stages]
    needs = replace(needs, results={**needs.results, **jobs})
    problems = tuple(each for job in lost for each in _reasons_of_job(job, needs, folder))
    others = [job for job in jobs if job not in (*STAGE_OF_JOB, COLLECTED_DATA)]
    return Gathered(results, jobs, problems, plan, tuple(line for job in others for line in _lines_of_job(job, folder)))


def _lines_of_job(job: str, folder: Path) -> Iterator[str]:
    """Yield what a job says in brief; nothing if it has left nothing that can be read."""
    file = folder / job / BRIEF_FILE
    with suppress(CalibrationError):
        found = read_brief(file) if file.exists() else Brief(verdict="pass", sentence="")
        yield from (f"{job}: {line}" for line in (found.sentence, *found.lines) if line)


def _reasons_of_job(job: str, needs: Needs, folder: Path) -> tuple[str, ...]:
    """Return the reasons why a job did not succeed: of its own results, or the error that it has reported."""
    if reasons := reasons_in(folder / job):
        return tuple(f"{job}: {reason}" for reason in reasons)
    if error := needs.errors.get(job):
        return (f"{job}: {brief(one_line(error))}",)
    result = needs.results[job]
    words = {JOB_SUCCESS: "left no result", "failure": "failed", "cancelled": "was cancelled", "skipped": "did not run"}
    what = words.get(result, f"is {result}")
    return (f"the job {job} {what}: see its log",)


def report_of_run(gathered: Gathered, cost: Cost, output: Path) -> Report:
    """Return the report of a whole run: its verdict covers all jobs, not only the results.

    Args:
        gathered: results of the jobs.
        cost: of the run.
        output: the folder of the results.
    """
    report_of_cells = report(gathered.results, Path())  # files are in the artifacts of the jobs, by their slugs
    others = [f"{job} {result}" for job, result in gathered.jobs.items() if result != JOB_SUCCESS]
    judged = [report_of_cells.sentence] if gathered.results.has_verdict else []
    verdict = gathered.verdict
    return replace(
        report_of_cells,
        verdict=verdict,
        error=gathered.exit_code,
        sentence="; ".join((*judged, *([", ".join(others)] if others else []))) or "all jobs succeeded",
        reasons=(*gathered.problems, *report_of_cells.reasons),
        blocks=(
            *report_of_cells.blocks,
            Lines(gathered.lines_of_jobs, title="Other jobs", only="summary", brief=True),
            jobs_table(gathered.jobs, cost),
            Text(cost.sentence),
            Lines((f"Cost: {cost.sentence}",), only="comment", brief=True),
        ),
        results=RunResults(**vars(report_of_cells.results), cost=cost),
        # The cells' own results stay in the artifacts of their jobs.
        files={CELLS_FILE: report_of_cells.files[CELLS_FILE], BADGE: verdict_badge(verdict)},
        outputs={
            **report_of_cells.outputs,
            "output": output,
            "billed-minutes": cost.minutes,
            "cost": money(cost.amount),
        },
    )


def _cells_of(job: JobCell, plan: WorkflowPlan, folder: Path) -> PipelineResults:
    """Return the results of one job of the matrix, in the order of the plan; missing ones have failed."""
    results = _read_results(folder / job.slug)
    by_start = {cell.start_of_cell: cell for cell in results.cells}
    planned = {_start_of_cell(cell): cell for cell in job.starts(plan.seeds)}
    cells = [by_start.get(start) or _result_of_missing_cell(cell, job) for start, cell in planned.items()]
    if unplanned := by_start.keys() - planned.keys():
        name = by_start[min(unplanned, key=str)].name
        raise InputError(
            f"{folder / job.slug / RESULTS_FILE}: has a result of {name}, which was not planned for this job"
        )
    comparisons = tuple(each for each in results.comparisons if each.system == job.system)
    exports = tuple(each for each in results.exports if each.system == job.system)
    return replace(results, cells=tuple(cells), comparisons=comparisons, exports=exports, collections=(), image=None)


def _start_of_cell(cell: Cell) -> tuple[str, float, float, int]:
    return (cell.system, cell.noise.translation, cell.noise.rotation, cell.noise.seed)


def _result_of_missing_cell(cell: Cell, job: JobCell) -> CellResult:
    result = nothing_yet(cell, SOFTWARE_METHOD if job.image else OUR_METHOD)
    return replace(result.failing(NO_RESULT), error=ExitCode.INFRASTRUCTURE)


def _collections_of(plan: WorkflowPlan, folder: Path) -> PipelineResults:
    if not plan.simulations:
        return PipelineResults()
    results = _read_results(folder / COLLECTED_DATA)
    by_name = {collected.name: collected for collected in results.collections}
    collections = [
        by_name.get(name) or Collected(name, reasons=(NO_RESULT,), error=ExitCode.INFRASTRUCTURE)
        for name in plan.simulations
    ]
    if unplanned := by_name.keys() - set(plan.simulations):
        raise InputError(f"{folder / COLLECTED_DATA / RESULTS_FILE}: has {min(unplanned)}, which was not planned")
    return replace(results, collections=tuple(collections))


def _stage_result(job: str, folder: Path) -> StageResult | None:
    """Return the result of the stage that a job has run; None if it has left none."""
    found: Any = getattr(_read_results(folder / job).of_stages, STAGE_OF_JOB[job].section)
    return None if found is None else replace(found, folder=f"{job}/{found.folder}")


def _read_results(folder: Path) -> PipelineResults:
    """Read the results in a folder, with their verdicts; empty if there is no file.

    Raises:
        InputError: the file is not a results file.
    """
    if not (folder / RESULTS_FILE).exists():
        return PipelineResults()
    results = read_results(folder)

    def below(path: str | None) -> str | None:
        return None if path is None else f"{folder.name}/{path}"

    def moved(cell: CellResult) -> CellResult:
        file = own_file(cell)
        details = own_details(cell, folder) if file is not None and (folder / file).exists() else None
        table, dataset, own = below(cell.table), below(cell.dataset), below(cell.folder)
        return replace(cell, table=table, dataset=dataset, folder=own, details=details)

    return replace(
        results.with_each_cell(moved),
        exports=tuple(replace(each, folder=f"{folder.name}/{each.folder}") for each in results.exports),
        collections=tuple(replace(each, dataset=below(each.dataset)) for each in results.collections),
    )
