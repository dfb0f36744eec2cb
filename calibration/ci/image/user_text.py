"""Validation and quoting of user texts for a Dockerfile."""

import json
import re
import unicodedata

from calibration.base.errors import InputError
from calibration.base.text import shorten

_PACKAGE_NAME = re.compile(r"[a-z0-9][a-z0-9+.-]*(:[a-z0-9]+)?(=[A-Za-z0-9.+~:-]+)?(/[a-z0-9-]+)?")


def check_text(text: str, where: str) -> str:
    """Return a text if it is safe for a shell: lines without control characters.

    Raises:
        InputError: it has control characters or lone surrogates.
    """
    for character in text:
        if unicodedata.category(character) in ("Cc", "Cs") and character not in "\n\t":
            name = f"U+{ord(character):04X}"
            raise InputError(f"{where}: found the control character {name} in {shorten(text)!r}: leave it out")
    return text


def check_line(text: str, where: str) -> str:
    """Return a text if it is a single line.

    Raises:
        InputError: it has several lines, or control characters.
    """
    if "\n" in text:
        raise InputError(f"{where}: found more than one line in {shorten(text)!r}, one was expected")
    return check_text(text, where)


def package_name(text: str, where: str) -> str:
    """Return the name of a Debian package, optionally with a version, if it is valid.

    Raises:
        InputError: it is invalid.
    """
    if not _PACKAGE_NAME.fullmatch(text):
        raise InputError(
            f"{where}: found {shorten(text)!r}, the name of a Debian package was expected (name, name=1.2)"
        )
    return text


def quoted(text: str) -> str:
    """Quote a value of ENV or LABEL so that the builder reads it literally."""
    return '"' + re.sub(r'(["\\$])', r"\\\1", text) + '"'


def json_words(*words: str) -> str:
    """Return words in the JSON form of an instruction, on one line.

    ``<`` is escaped, because newer builders take ``<<`` for a here-document.
    """
    return json.dumps(list(words), ensure_ascii=False).replace("<", "\\u003c")


def path_words(*paths: str) -> str:
    """Return paths of COPY and WORKDIR in JSON form, escaped against the builder's variables and quotes."""
    return json_words(*(re.sub(r"""(["'\\$])""", r"\\\1", path) for path in paths))
