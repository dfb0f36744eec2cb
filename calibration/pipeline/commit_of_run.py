"""Commit that a run tests, for its reports."""

from collections.abc import Mapping
from pathlib import Path

from calibration.base.errors import CalibrationError
from calibration.ci.git.event import Event
from calibration.ci.git.repository import Repository
from calibration.pipeline.results import CommitOfRun


def commit_of_run(folder: Path, environment: Mapping[str, str]) -> CommitOfRun | None:
    """Return the commit of the checkout around a folder; None without a checkout, a commit or git.

    On a pull request the checkout is a merge that nobody has written, so the hash is that of the branch.
    """
    try:
        commit = Repository.around(folder.resolve()).newest()
        branch = Event.from_environment(environment).at("pull_request", "head", "sha")
    except CalibrationError:
        return None
    if commit is None:
        return None
    return CommitOfRun(branch if isinstance(branch, str) else commit.hash, commit.date)
