"""Coverage of the lines of a change."""

from collections.abc import Mapping

from calibration.addons.coverage.lines import FileCoverage, Rate
from calibration.addons.coverage.results import Span


def coverage_of_change(
    changed: Mapping[str, set[int]], files: Mapping[str, FileCoverage]
) -> tuple[Rate, tuple[Span, ...]]:
    """Return the coverage of the changed executable lines, and the spans that no test runs."""
    total = Rate()
    missing: list[Span] = []
    for path in sorted(changed.keys() & files.keys()):
        part = {line: hits for line, hits in files[path].hits.items() if line in changed[path]}
        coverage = FileCoverage(part)
        total += coverage.line_rate
        missing += [Span(path, *each) for each in files[path].ranges(coverage.missing)]
    return total, tuple(missing)
