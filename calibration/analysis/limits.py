"""Limits of the number of findings: ``error=0``, ``security=3``, ``all=100``."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from calibration.analysis.finding import CATEGORIES, SEVERITIES, Finding
from calibration.errors import InputError
from calibration.report import Check, at_most
from calibration.workflow.text import did_you_mean, shorten

EVERY = "all"
_LIMIT = re.compile(r"([a-z -]+)=([0-9]{1,9})")
_KINDS = (EVERY, *SEVERITIES, *CATEGORIES)


@dataclass(frozen=True)
class Limit:
    """Limit of the number of findings of a kind."""

    kind: str
    """A severity, a category, or all."""
    most: int

    def check(self, findings: Sequence[Finding], what: str) -> Check:
        """Check the number of findings; ``what`` describes them in the message: new, all."""
        count = sum(self.kind in (EVERY, finding.severity, finding.category) for finding in findings)
        kind = "" if self.kind == EVERY else f" ({self.kind})"
        return at_most(f"{what} findings{kind}", count, self.most)


def parse_limits(texts: Sequence[str], option: str) -> list[Limit]:
    """Parse limits from options.

    Raises:
        InputError: a limit is invalid, or of an unknown kind.
    """
    limits = []
    for text in texts:
        match = _LIMIT.fullmatch(text.strip())
        if match is None:
            raise InputError(f"{option}: found {shorten(text)!r}, expected a limit such as error=0 or all=100")
        kind = match[1].strip()
        if kind not in _KINDS:
            known = ", ".join(_KINDS)
            raise InputError(f"{option}: found {kind!r}, expected one of {known}{did_you_mean(kind, _KINDS)}")
        limits.append(Limit(kind, int(match[2])))
    return limits
