"""Extent of a change: its base commit, and the lines that it adds, from the output of ``git diff``."""

import re
from collections.abc import Iterable

from calibration.base.errors import InputError
from calibration.ci.git.repository import Repository

_HUNK_HEADER = re.compile(rb"@@ -[0-9]{1,12}(?:,([0-9]{1,12}))? \+([0-9]{1,12})(?:,([0-9]{1,12}))? @@")
_BINARY_FILES = re.compile(rb'Binary files .* and ("?b/.*) differ')
_ESCAPED_CHARACTER = re.compile(rb"\\([0-7]{3}|.)")
_CHARACTER_OF_LETTER = {b"a": b"\a", b"b": b"\b", b"f": b"\f", b"n": b"\n", b"r": b"\r", b"t": b"\t", b"v": b"\v"}


def changed_lines(difference: bytes) -> dict[str, set[int]]:
    """Return the numbers of the added or altered lines of each file, by its path.

    Args:
        difference: output of git without context, with the prefixes ``a/`` and ``b/``.
    """
    found: dict[str, set[int]] = {}
    file: str | None = None
    skip = number = 0  # remaining lines of a hunk, whose content must not be parsed as headers; the next line's number
    for line in difference.split(b"\n"):
        if skip and not line.startswith(b"\\"):  # "\ No newline at end of file" is not a line
            skip -= 1
            if line.startswith(b"+") and file is not None:  # counted, as a hunk may claim any number
                found[file].add(number)
                number += 1
        elif line.startswith(b"+++ "):
            file = _new_path(line[4:])
        elif (hunk := _HUNK_HEADER.match(line)) is not None:
            number = int(hunk[2])
            skip = int(hunk[1] or 1) + int(hunk[3] or 1)
            if file is not None:
                found.setdefault(file, set())
    return found


def files_without_lines(difference: bytes) -> set[str]:
    """Return the changed files of which git tells no lines: those that .gitattributes calls binary, or large ones.

    Args:
        difference: output of git, with the prefixes ``a/`` and ``b/``.
    """
    names = (each[1] for line in difference.split(b"\n") if (each := _BINARY_FILES.fullmatch(line)) is not None)
    return {path for path in map(_new_path, names) if path is not None}


def find_base(repository: Repository, named: str | None, candidates: Iterable[str]) -> str:
    """Return the merge base of HEAD and the target of a change.

    Args:
        repository: the checkout.
        named: commit given by the user; None to use the first existing candidate.
        candidates: commits suggested by the event, in order of preference.

    Raises:
        InputError: there is nothing to compare with, or this checkout lacks it.
    """
    names = [named] if named is not None else list(candidates)
    if not names:
        raise InputError("there is no base to compare with: set base, for example to origin/main")
    # after a forced push the best candidate may no longer exist
    commit = next(filter(None, map(repository.commit, names)), None)
    base = None if commit is None else repository.merge_base(commit, "HEAD")
    if base is None:
        found = "no such commit is" if commit is None else "no common ancestor with HEAD is"
        raise InputError(f"base {names[0]}: {found} in this checkout: check out the history too (fetch-depth: 0)")
    return base


def _new_path(text: bytes) -> str | None:
    """Return the path in a ``+++`` line; None for a deleted file."""
    text = text.removesuffix(b"\t")  # git appends a tab to a path with a space
    if text.startswith(b'"') and text.endswith(b'"'):
        text = _ESCAPED_CHARACTER.sub(_unescape_match, text[1:-1])
    return text[2:].decode("utf-8", "surrogateescape") if text.startswith(b"b/") else None


def _unescape_match(match: re.Match[bytes]) -> bytes:
    escaped = match[1]
    return bytes([int(escaped, 8)]) if len(escaped) == 3 else _CHARACTER_OF_LETTER.get(escaped, escaped)
