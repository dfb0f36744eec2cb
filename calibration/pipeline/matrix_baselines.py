"""The checkout around a run: its commit, and the baselines of the systems with their changes since the base branch."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from calibration.base.errors import CalibrationError
from calibration.ci.git import Repository
from calibration.ci.services import event_of
from calibration.ci.workflow.runner import Event
from calibration.engine.baseline.document import MAX_BASELINE_BYTES, Baseline, parse_baseline, read_baseline
from calibration.engine.baseline.settings import BaselineSettings
from calibration.engine.baseline.update import BaselineUpdate, updates
from calibration.engine.baseline.verdict import Accepted
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.results import CommitOfRun


def with_accepted(
    matrix: Matrix, settings: BaselineSettings, environment: Mapping[str, str]
) -> tuple[Matrix, BaselineUpdate]:
    """Return the matrix with the accepted calibration of each system, and the changes of the baseline under test.

    Args:
        matrix: the systems.
        settings: of the comparison.
        environment: the runner's description of the tested event.

    Raises:
        InputError: the file is not a valid baseline.
    """
    baseline = read_baseline(settings.file)
    known = baseline.systems if baseline else {}
    try:
        repository = Repository.around(settings.file.resolve().parent)
    except CalibrationError:  # no git, or no checkout: there is only the file
        repository = None
    since = settings.file.name + (_last_change(settings.file, repository) if baseline and repository else "")
    systems = (replace(system, accepted=Accepted(settings, known.get(system.name), since)) for system in matrix.systems)
    names = [system.name for system in matrix.systems]
    found = BaselineUpdate(
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
    found: BaselineUpdate,
    now: Baseline | None,
    settings: BaselineSettings,
    repository: Repository,
    environment: Mapping[str, str],
) -> BaselineUpdate:
    """Return the update with the changes of the base's file; an unreadable base is reported in it."""
    try:
        path = repository.path(settings.file)
        commit = _base_commit(repository, event_of(environment))
        if path is None or commit is None:
            return found
        found = replace(found, base=commit)
        content = repository.content(commit, path, MAX_BASELINE_BYTES)
        before = None if content is None else parse_baseline(content, f"{commit[:12]}:{path}")
    except CalibrationError as error:
        problem = f"the base branch's baseline cannot be compared with: {error}"
        return replace(found, problem=problem, reasons=(problem,) if settings.required else ())
    return replace(found, updates=updates(before, now))


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
