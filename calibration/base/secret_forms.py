"""Forms in which a secret may be printed, and their redaction."""

import base64
import json
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
