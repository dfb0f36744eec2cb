"""Commit that a run tests, for its reports."""

from collections.abc import Mapping
from pathlib import Path

from calibration.base.errors import CalibrationError
from calibration.ci.git.repository import Repository
from calibration.ci.services import event_of
from calibration.pipeline.results import CommitOfRun


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
