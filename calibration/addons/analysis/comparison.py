"""Comparison of findings with those of an earlier state: matched by rule and content, never by line number."""

import re
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from calibration.addons.analysis.copies import Copy
from calibration.addons.analysis.results import CodeFinding

_FORMATTING_CHARACTERS = re.compile(r"[\s,;()'\"\\]+")
"""Characters that formatters move, add and remove."""


@dataclass(frozen=True)
class Located:
    """Finding with the content of its line, to match it after the line has moved."""

    finding: CodeFinding
    content: str
    """The line, without what formatters change; the message if the line is empty."""


def plain_content(text: str) -> str:
    """Return a text without spaces, line ends, quotes, commas and parentheses."""
    return _FORMATTING_CHARACTERS.sub("", text)


def located(finding: CodeFinding, lines: Sequence[str]) -> Located:
    """Return a finding with the content of its line; ``lines`` are those of its file."""
    text = lines[finding.line - 1] if 1 <= finding.line <= len(lines) else ""
    return Located(finding, plain_content(text) or finding.message)


@dataclass(frozen=True)
class Compared:
    """New, known and fixed findings of two states of a repository."""

    new: tuple[CodeFinding, ...]
    unchanged: tuple[CodeFinding, ...]
    fixed: tuple[CodeFinding, ...]
    """Fixed findings, at their lines in the earlier state."""


def with_content(findings: Sequence[CodeFinding], copy: Copy) -> list[Located]:
    """Return findings with the content of their lines."""
    lines = {path: copy.lines(path) for path in {finding.path for finding in findings}}
    return [located(finding, lines[finding.path]) for finding in findings]


def compare(
    now: Sequence[CodeFinding],
    copy: Copy,
    earlier: Sequence[CodeFinding],
    base: Copy,
    changed: Collection[str],
    whole: Collection[str] = (),
) -> Compared:
    """Compare findings with those of an earlier state, in which only the changed files were analysed.

    The analysers that ``whole`` names were run on all files of the earlier state.

    A finding is known if the earlier state has one of its rule on a line of the same content, in any file; or one of
    its rule and message in a file that has the content anywhere, as when a formatter has broken the line. Each earlier
    finding matches at most one.
    """
    touched = set(changed)

    def is_open(finding: CodeFinding) -> bool:
        return finding.path in touched or finding.rule.partition("/")[0] in whole

    unchanged = [finding for finding in now if not is_open(finding)]
    open_now = with_content([finding for finding in now if is_open(finding)], copy)
    open_before = with_content(earlier, base)
    open_now, open_before, matched = _match_by_key(
        open_now, open_before, lambda each: (each.finding.rule, each.content)
    )
    unchanged += matched
    texts: dict[str, str] = {}

    def was_there(new: Located, old: Located) -> bool:
        path = old.finding.path
        texts.setdefault(path, plain_content(base.text(path)))
        return new.content in texts[path]

    new = []
    for each in open_now:
        same = (
            old
            for old in open_before
            if (old.finding.rule, old.finding.message) == (each.finding.rule, each.finding.message)
            and was_there(each, old)
        )
        if (known := next(same, None)) is None:
            new.append(each.finding)
        else:
            open_before.remove(known)
            unchanged.append(each.finding)
    return Compared(tuple(new), tuple(unchanged), tuple(each.finding for each in open_before))


def _match_by_key(
    now: Sequence[Located], earlier: Sequence[Located], key: Callable[[Located], tuple[str, str]]
) -> tuple[list[Located], list[Located], list[CodeFinding]]:
    """Return the current and earlier findings without a partner, and the current ones with a partner.

    Partners in the same file are matched first, so that the remaining ones are at the expected file.
    """
    matched: list[CodeFinding] = []
    for full in (lambda each: (each.finding.path, *key(each)), key):
        counts = Counter(map(full, earlier))
        rest = []
        for each in now:
            if counts[full(each)] > 0:
                counts[full(each)] -= 1
                matched.append(each.finding)
            else:
                rest.append(each)
        left = []
        for each in reversed(earlier):
            if counts[full(each)] > 0:
                counts[full(each)] -= 1
                left.append(each)
        now, earlier = rest, left[::-1]
    return list(now), list(earlier), matched
