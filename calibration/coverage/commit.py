"""Which commit the coverage is of."""

from calibration.errors import InputError
from calibration.git.event import Event
from calibration.git.repository import Repository, is_commit
from calibration.workflow.text import one_line, shorten


def find_commit(given: str | None, event: Event, repository: Repository) -> tuple[str, str]:
    """The commit that coverage is reported for, and where that is from.

    That of a pull request is its own last one, not the merge that GitHub makes to test it. In a
    ``pull_request_target`` it is what is checked out, which unless asked otherwise is the base.

    Raises:
        InputError: the one that is given is no hash of a commit, or there is none at all.
    """
    if given is not None:
        if not is_commit(given.lower()):
            raise InputError(f"commit: found {shorten(one_line(given))!r}, expected the 40 hexadecimal digits of one")
        return given.lower(), "as given"
    head = repository.head()
    pull_request = event.at("pull_request", "head", "sha")
    candidates = [
        (pull_request if event.name != "pull_request_target" else None, "the pull request's last"),
        (event.at("workflow_run", "head_sha"), "that of the workflow that this one follows"),
    ]
    if event.name == "pull_request_target" and head is not None:
        merged = isinstance(pull_request, str) and pull_request in repository.parents(head)
        candidates.append((pull_request if merged else head, "the one that is checked out"))
    candidates += [(event.sha, "GITHUB_SHA"), (head, "the one that is checked out")]
    for sha, source in candidates:
        if isinstance(sha, str) and is_commit(sha):
            return sha, source
    raise InputError("commit is not given, and nothing is checked out: there is no commit to report for")
