"""Baselines of a run: its commit, the accepted calibrations that it is compared with, and accepting its results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from calibration.base import CalibrationError, InputError, did_you_mean, parse_number, shorten
from calibration.base.tables.table import KeyedTable, LabelledRow, read_table
from calibration.ci.git import Repository
from calibration.ci.services import event_of
from calibration.ci.workflow.runner import Event
from calibration.engine.baseline import document
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.quality import BaselineSettings
from calibration.engine.baseline.verdict import Accepted
from calibration.engine.diagnosis.finding import FindingKind
from calibration.engine.evaluation.table import AVERAGES_ROW
from calibration.pipeline.matrix.cell_result import OUR_METHOD, CellResult
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.matrix.software_cell import start_of
from calibration.pipeline.results import CommitOfRun, PipelineResults, own_details


def with_accepted(
    matrix: Matrix, settings: BaselineSettings, environment: Mapping[str, str]
) -> tuple[Matrix, document.BaselineUpdate]:
    """Return the matrix with the accepted calibration of each system, and the changes of the baseline under test.

    Args:
        matrix: the systems.
        settings: of the comparison.
        environment: the runner's description of the tested event.

    Raises:
        InputError: the file is not a valid baseline.
    """
    baseline = document.read_baseline(settings.file)
    known = baseline.systems if baseline else {}
    try:
        repository = Repository.around(settings.file.resolve().parent)
    except CalibrationError:  # no git, or no checkout: there is only the file
        repository = None
    since = settings.file.name + (_last_change(settings.file, repository) if baseline and repository else "")
    systems = (replace(system, accepted=Accepted(settings, known.get(system.name), since)) for system in matrix.systems)
    names = [system.name for system in matrix.systems]
    found = document.BaselineUpdate(
        file=str(settings.file),
        since=since,
        compared=tuple(name for name in names if name in known),
        not_accepted=tuple(name for name in names if name not in known),
        unused=tuple(sorted(known.keys() - set(names))),
    )
    if repository is not None:
        found = _against_base(found, baseline, settings, repository, environment)
    return replace(matrix, systems=tuple(systems)), found


def _against_base(
    found: document.BaselineUpdate,
    now: document.Baseline | None,
    settings: BaselineSettings,
    repository: Repository,
    environment: Mapping[str, str],
) -> document.BaselineUpdate:
    """Return the update with the changes of the base's file; an unreadable base is reported in it."""
    try:
        path = repository.path(settings.file)
        commit = _base_commit(repository, event_of(environment))
        if path is None or commit is None:
            return found
        found = replace(found, base=commit)
        content = repository.content(commit, path, document.MAX_BASELINE_BYTES)
        before = None if content is None else document.parse_baseline(content, f"{commit[:12]}:{path}")
    except CalibrationError as error:
        problem = f"the base branch's baseline cannot be compared with: {error}"
        return replace(found, problem=problem, reasons=(problem,) if settings.required else ())
    return replace(found, updates=document.updates(before, now))


def _base_commit(repository: Repository, event: Event) -> str | None:
    """Return the commit that a change is compared with; the checkout's own outside of a change; None without one.

    A shallow checkout of a pull request has the base as the merge's first parent (``fetch-depth: 2``); else that one
    commit is fetched.

    Raises:
        InputError: it is missing, and cannot be fetched.
    """
    for name in event.bases:
        if (commit := repository.commit(name)) is not None:
            return commit
    head = repository.head()
    if head is None or not event.bases:
        return head
    for parent in repository.parents(head)[:1]:
        if (commit := repository.commit(parent)) is not None:
            return commit
    return repository.fetched(event.bases[0])


def _last_change(path: Path, repository: Repository) -> str:
    """Return the last commit of the file, for messages; empty if it has none."""
    try:
        inside = repository.path(path)
        commits = repository.changes_of(inside, newest=1) if inside else []
    except CalibrationError:
        return ""
    return f" of {commits[0]}" if commits else ""


def commit_of_run(folder: Path, environment: Mapping[str, str]) -> CommitOfRun | None:
    """Return the commit of the checkout around a folder; None without a checkout, a commit or git.

    On a pull request the checkout is a merge that nobody has written, so the hash is that of the branch.
    """
    try:
        commit = Repository.around(folder.resolve()).newest()
        branch = event_of(environment).pull_request_commit
    except CalibrationError:
        return None
    if commit is None:
        return None
    return CommitOfRun(branch or commit.hash, commit.date)


@dataclass(frozen=True)
class AcceptedSystems:
    """Accepted calibrations, for add-ons that keep something with them."""

    file: Path
    """The baseline's."""
    baseline: document.Baseline
    """With them."""
    datasets: Mapping[str, Path]
    """Dataset of each accepted system."""


ABOUT_THE_BASELINE: tuple[FindingKind, ...] = ("baseline", "baseline-quality", "no-baseline")
"""Kinds of findings that are resolved by accepting."""


def accept(
    results: PipelineResults, output: Path, names: Sequence[str], although: str | None, before: document.Baseline | None
) -> tuple[document.Baseline, tuple[str, ...]]:
    """Return the baseline with the results of a run.

    Args:
        results: of the run.
        output: its output folder.
        names: the systems to accept; empty for all.
        although: reason for accepting a system that has failed.
        before: the baseline so far; other systems are unchanged.

    Returns:
        The baseline, and the names of the accepted systems.

    Raises:
        InputError: a system is not in the results, has no calibration, or has failed without a reason for accepting it.
    """
    known = tuple(dict.fromkeys(cell.system for cell in results.cells))
    for name in names:
        if name not in known:
            raise InputError(
                f"{output}: there is no result of '{name}'{did_you_mean(name, known)} (found: {', '.join(known)})"
            )
    accepted = {name: _accepted_snapshot(name, results, output, although) for name in names or known}
    if not accepted:
        raise InputError(f"{output}: there is no calibrated system to accept: run the calibration first")
    systems = {**(before.systems if before else {}), **accepted}
    return document.Baseline(document.BASELINE_VERSION, dict(sorted(systems.items()))), tuple(accepted)


def _accepted_snapshot(
    system: str, results: PipelineResults, output: Path, although: str | None
) -> CalibrationDocument:
    cells = [cell for cell in results.cells if cell.system == system]
    failed = [(cell, why) for cell in cells if (why := _unsettled_reasons(cell))]
    if failed and although is None:
        cell, why = failed[0]
        what = "has failed" if cell.verdict == "fail" else "is undecided"
        raise InputError(
            f"{cell.name}: {what} ({shorten(why[0], 200)}); what {what} is accepted with --although 'why' only"
        )
    references = [cell for cell in results.comparisons if cell.system == system and not cell.by_other_method]
    ours = [cell for cell in cells if cell.method == OUR_METHOD] or references
    for cell in ours:
        details = own_details(cell, output) if cell.converged else None
        if details is not None and details.snapshot is not None:
            return replace(
                details.snapshot,
                averages=_table_averages(output / cell.table) if cell.table else {},
                passed=len(cells) - len(failed),
                starts=len(cells),
                software=tuple(
                    start_of(cell, not _unsettled_reasons(cell)) for cell in cells if cell.method != OUR_METHOD
                ),
                although=although if failed else None,
            )
    raise InputError(f"{output}: {system}: no cell has a calibration that could be accepted")


def _unsettled_reasons(cell: CellResult) -> tuple[str, ...]:
    """Return the reasons why a cell has failed, without those that accepting resolves."""
    settled = {finding.text for finding in cell.findings if finding.kind in ABOUT_THE_BASELINE}
    reasons = tuple(reason for reason in cell.reasons if reason not in settled)
    if not reasons and cell.verdict == "undecided" and not cell.undecided_passes:
        reasons = cell.undecided
    return reasons or (() if cell.converged else ("it has not converged",))


def _table_averages(path: Path) -> dict[str, float]:
    """Return the row of averages of a table, by column; empty if there is none."""
    table = read_table(path)
    keyed = KeyedTable.of(table, None, ())
    row = keyed.row(LabelledRow(AVERAGES_ROW)) if AVERAGES_ROW in keyed.labels else None
    numbers = {} if row is None else {column: parse_number(row.cells[table.column(column)]) for column in table.header}
    return {column: number for column, number in numbers.items() if number is not None}
