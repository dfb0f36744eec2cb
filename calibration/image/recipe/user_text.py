"""Texts of the user that go into a Dockerfile: what they may hold, and how they are quoted there."""

import json
import re
import unicodedata

from calibration.errors import InputError
from calibration.workflow.text import shorten

_PACKAGE = re.compile(r"[a-z0-9][a-z0-9+.-]*(:[a-z0-9]+)?(=[A-Za-z0-9.+~:-]+)?(/[a-z0-9-]+)?")


def check_text(text: str, where: str) -> str:
    """Return a text that a shell can be given: lines, without control characters.

    Raises:
        InputError: it has some, or half a character.
    """
    for character in text:
        if unicodedata.category(character) in ("Cc", "Cs") and character not in "\n\t":
            name = f"U+{ord(character):04X}"
            raise InputError(f"{where}: found the control character {name} in {shorten(text)!r}: leave it out")
    return text


def check_line(text: str, where: str) -> str:
    """Return a text of one line.

    Raises:
        InputError: it has several, or control characters.
    """
    if "\n" in text:
        raise InputError(f"{where}: found more than one line in {shorten(text)!r}, one was expected")
    return check_text(text, where)


def package_name(text: str, where: str) -> str:
    """Return the name of a Debian package, with its version where there is one.

    Raises:
        InputError: it is none.
    """
    if not _PACKAGE.fullmatch(text):
        raise InputError(
            f"{where}: found {shorten(text)!r}, the name of a Debian package was expected (name, name=1.2)"
        )
    return text


def quoted(text: str) -> str:
    """A value of ENV and LABEL, which the builder reads back as it is."""
    return '"' + re.sub(r'(["\\$])', r"\\\1", text) + '"'


def json_words(*words: str) -> str:
    """The form of an instruction in which nothing but JSON has a meaning, on one line.

    A ``<`` could begin a here-document for newer builders, so it is written as an escape.
    """
    return json.dumps(list(words), ensure_ascii=False).replace("<", "\\u003c")


def path_words(*paths: str) -> str:
    """Paths of COPY and WORKDIR: JSON, in which the builder replaces variables and takes quotes away."""
    return json_words(*(re.sub(r"""(["'\\$])""", r"\\\1", path) for path in paths))
