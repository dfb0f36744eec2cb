"""Secrets kept out of the log."""

import base64
import json
from collections.abc import Iterable
from urllib.parse import quote

from calibration.workflow.commands import workflow_command
from calibration.workflow.runner import Runner

SHORTEST_PART = 4
"""Characters; a shorter line of a secret (a brace, a bracket) is no secret and would hide half the log."""


def add_mask(runner: Runner, secret: str) -> None:
    """Tell the runner to hide a secret, in every form in which it may reach the log.

    Call it before anything else is printed. Off GitHub it prints nothing: use :func:`redact`.
    """
    if runner.github:
        for form in derived_forms(secret):
            runner.log(workflow_command("add-mask", form))


def redact(text: str, secrets: Iterable[str]) -> str:
    """Replace secrets, in every form of :func:`derived_forms`, by ``***``."""
    forms = {form for secret in secrets for form in derived_forms(secret)}
    for form in sorted(forms, key=len, reverse=True):
        text = text.replace(form, "***")
    return text


def derived_forms(secret: str) -> list[str]:
    """List the forms in which a secret may be printed.

    As it is, without the white space around it, each of its lines, as a JSON string, in a URL, and
    in base64; parts shorter than :data:`SHORTEST_PART` are left out unless they are the secret.
    """
    whole = secret.strip()
    if not whole:
        return []
    encoded = whole.encode("utf-8", "surrogateescape")
    standard = base64.b64encode(encoded).decode("ascii")
    forms = [secret, whole, json.dumps(whole)[1:-1], quote(encoded, safe=""), quote(encoded)]
    forms += [standard, standard.rstrip("="), base64.urlsafe_b64encode(encoded).decode("ascii")]
    forms += [line.strip() for line in whole.splitlines() if len(line.strip()) >= SHORTEST_PART]
    return list(dict.fromkeys(forms))
