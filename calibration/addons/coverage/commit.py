"""Commit that the coverage belongs to, and the coverage of the lines that it changes."""

from collections.abc import Mapping

from calibration.addons.coverage.lines import FileCoverage, Rate
from calibration.addons.coverage.results import CoverageOfChange, Span
from calibration.base.errors import InputError
from calibration.base.text import one_line, shorten
from calibration.ci.git import Repository, is_commit
from calibration.ci.workflow.runner import Event


def find_commit(given: str | None, event: Event, repository: Repository) -> tuple[str, str]:
    """Return the commit to report coverage for, and the source of that information.

    For a pull request it is the head commit, not the merge commit that GitHub creates for testing. For
    ``pull_request_target`` it is the commit that is checked out, by default the base.

    Raises:
        InputError: the given commit is not a full hash, or no commit is known.
    """
    if given is not None:
        if not is_commit(given.lower()):
            raise InputError(f"commit: found {shorten(one_line(given))!r}, expected a hash of 40 hexadecimal digits")
        return given.lower(), "as given"
    head = repository.head()
    pull_request = event.pull_request_commit
    candidates = [
        (None if event.checks_out_base else pull_request, "the pull request's last"),
        (event.followed_commit, "that of the workflow that this one follows"),
    ]
    if event.checks_out_base and head is not None:
        merged = pull_request is not None and pull_request in repository.parents(head)
        candidates.append((pull_request if merged else head, "the one that is checked out"))
    candidates += [(event.commit, "GITHUB_SHA"), (head, "the one that is checked out")]
    for sha, source in candidates:
        if sha is not None and is_commit(sha):
            return sha, source
    raise InputError("commit is not given, and there is no checkout: set commit, or check out the repository")


def coverage_of_change(
    base: str, changed: Mapping[str, set[int]], files: Mapping[str, FileCoverage]
) -> CoverageOfChange:
    """Return the coverage of the changed executable lines and of the functions that have any, and what no test runs."""
    total = functions = Rate()
    missing: list[Span] = []
    for path in sorted(changed.keys() & files.keys()):
        part = {line: hits for line, hits in files[path].hits.items() if line in changed[path]}
        coverage = FileCoverage(part)
        total += coverage.line_rate
        missing += [Span(path, *each) for each in files[path].ranges(coverage.missing)]
        spans = {
            span: hits
            for span, hits in files[path].functions.items()
            if any(span[0] <= line <= span[1] for line in changed[path])
        }
        functions += FileCoverage(functions=spans).function_rate
    return CoverageOfChange(base, total, tuple(missing), functions)
