"""Redaction of secrets, in every form in which they may be printed: in texts, and in streams of bytes."""

import base64
import json
import re
from collections.abc import Iterable
from urllib.parse import quote

MIN_PART_LENGTH = 4
"""Minimum length in characters; shorter lines of a secret (a brace, a bracket) would mask half the log."""


def redact(text: str, secrets: Iterable[str]) -> str:
    """Replace secrets, in every form of :func:`derived_forms`, by ``***``."""
    forms = {form for secret in secrets for form in derived_forms(secret)}
    for form in sorted(forms, key=len, reverse=True):
        text = text.replace(form, "***")
    return text


def derived_forms(secret: str) -> list[str]:
    """Return the forms in which a secret may be printed.

    Unchanged, stripped of white space, each of its lines, as a JSON string, in a URL, and
    in base64; parts shorter than :data:`MIN_PART_LENGTH` are omitted unless they are the whole secret.
    """
    whole = secret.strip()
    if not whole:
        return []
    encoded = whole.encode("utf-8", "surrogateescape")
    standard = base64.b64encode(encoded).decode("ascii")
    forms = [secret, whole, json.dumps(whole)[1:-1], quote(encoded, safe=""), quote(encoded)]
    forms += [standard, standard.rstrip("="), base64.urlsafe_b64encode(encoded).decode("ascii")]
    forms += [line.strip() for line in whole.splitlines() if len(line.strip()) >= MIN_PART_LENGTH]
    return list(dict.fromkeys(forms))


REDACTED_BYTES = b"***"


class Redactor:
    """Replaces secrets in a stream, in every form of :func:`calibration.base.redaction.derived_forms`.

    Bytes that may be the beginning of a secret are delayed until this is known.
    """

    def __init__(self, secrets: Iterable[str]) -> None:
        forms = {form.encode("utf-8", "surrogateescape") for secret in secrets for form in derived_forms(secret)}
        self._forms = sorted(forms, key=len, reverse=True)
        self._pattern = re.compile(b"|".join(map(re.escape, self._forms))) if self._forms else None
        self._held = b""

    def feed(self, data: bytes) -> bytes:
        """Add bytes of the stream; return those that can be shown."""
        if self._pattern is None:
            return data
        data, shown = self._held + data, bytearray()
        position = 0
        while True:
            open_end = self._possible_beginning(data, position)
            match = self._pattern.search(data, position)
            if match is None or match.start() >= open_end:
                shown += data[position:open_end]
                self._held = data[open_end:]
                return bytes(shown)
            shown += data[position : match.start()] + REDACTED_BYTES
            position = match.end()

    def close(self) -> bytes:
        """Return the delayed bytes at the end of the stream."""
        held, self._held = self._held, b""
        return held if self._pattern is None else self._pattern.sub(REDACTED_BYTES, held)

    def _possible_beginning(self, data: bytes, start: int) -> int:
        """Return the position where an incomplete secret may begin; the length of the data if there is none."""
        earliest = len(data)
        for form in self._forms:
            position = data.find(form[:1], max(start, len(data) - len(form) + 1))
            while 0 <= position < earliest:
                if form.startswith(data[position:]):
                    earliest = position
                    break
                position = data.find(form[:1], position + 1)
        return earliest
