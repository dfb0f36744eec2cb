"""What started a run, in terms of git."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Event:
    """What started the run, as its CI service tells; nothing is known on a terminal."""

    name: str = ""
    """The service's own name: push, pull_request; empty on a terminal."""
    commit: str = ""
    """Hash of the commit that the service runs on; of a pull request it may be a merge made for testing."""
    pull_request_commit: str | None = None
    """Hash of the last commit of the pull request's branch."""
    followed_commit: str | None = None
    """Hash of the commit of the earlier run that this one follows."""
    checks_out_base: bool = False
    """Whether the checkout of a pull request is its base, unless the workflow asks for another commit."""
    by_stranger: str | None = None
    """Reason why the run has neither secrets nor a write token; None if it has."""
    without_secrets: str | None = None
    """Reason why the run has no access to the team's secrets; None if it has."""
    without_comment: str | None = None
    """Reason why the run cannot write comments; None if it can."""
    bases: tuple[str, ...] = ()
    """Commits or branches that a change may be compared with, in order of preference."""
