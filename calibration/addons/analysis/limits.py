"""Limits of the number of findings: ``error=0``, ``security=3``, ``all=100``."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from calibration.addons.analysis.finding import CATEGORIES, SEVERITIES, Finding
from calibration.base.errors import InputError
from calibration.base.text import did_you_mean, shorten
from calibration.ci.report import Check, at_most

EVERY_FINDING = "all"
MOST_FILES = 20
"""Limit of the files that are named for a limit of each file."""
_LIMIT_TEXT = re.compile(r"([a-z -]+)=([0-9]{1,9})")
_KINDS_OF_FINDINGS = (EVERY_FINDING, *SEVERITIES, *CATEGORIES)


@dataclass(frozen=True)
class Limit:
    """Limit of the number of findings of a kind."""

    kind: str
    """A severity, a category, or all."""
    most: int

    def check(self, findings: Sequence[Finding], what: str) -> Check:
        """Check the number of findings; ``what`` describes them in the message: new, all."""
        return at_most(
            f"{what} findings{self._kind_in_parentheses}", sum(map(self._concerns_finding, findings)), self.most
        )

    def check_files(self, findings: Sequence[Finding]) -> list[Check]:
        """Check the number of findings of each file: those with too many, the worst first, or else the worst one."""
        counts = Counter(finding.path for finding in findings if self._concerns_finding(finding)).most_common(
            MOST_FILES
        )
        broken = [each for each in counts if each[1] > self.most]
        return [
            at_most(f"findings{self._kind_in_parentheses} of {shorten(path)}", count, self.most)
            for path, count in broken or counts[:1]
        ]

    def _concerns_finding(self, finding: Finding) -> bool:
        return self.kind in (EVERY_FINDING, finding.severity, finding.category)

    @property
    def _kind_in_parentheses(self) -> str:
        return "" if self.kind == EVERY_FINDING else f" ({self.kind})"


def parse_limits(texts: Sequence[str], option: str) -> list[Limit]:
    """Parse limits from options.

    Raises:
        InputError: a limit is invalid, or of an unknown kind.
    """
    limits = []
    for text in texts:
        match = _LIMIT_TEXT.fullmatch(text.strip())
        if match is None:
            raise InputError(f"{option}: found {shorten(text)!r}, expected a limit such as error=0 or all=100")
        kind = match[1].strip()
        if kind not in _KINDS_OF_FINDINGS:
            known = ", ".join(_KINDS_OF_FINDINGS)
            raise InputError(
                f"{option}: found {kind!r}, expected one of {known}{did_you_mean(kind, _KINDS_OF_FINDINGS)}"
            )
        limits.append(Limit(kind, int(match[2])))
    return limits
