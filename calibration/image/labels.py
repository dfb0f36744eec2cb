"""Labels of the origin of an image."""

import os
import subprocess
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit, urlunsplit

from calibration.image.content_key import KEY_LABEL, SPECIFICATION_LABEL
from calibration.workflow.text import one_line

SOURCE = "org.opencontainers.image.source"
REVISION = "org.opencontainers.image.revision"
SECONDS = 10
"""Timeout of a git command."""


def build_labels(
    key: str, specification: str, user: Mapping[str, str], folder: Path, environment: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the labels of an image that is built now: the user's, the keys, and the commit if it is known.

    An image that is found later, unchanged, keeps the commit of its build. There is no date, because
    images have a date of creation.
    """
    variables = os.environ if environment is None else environment
    server, repository = variables.get("GITHUB_SERVER_URL"), variables.get("GITHUB_REPOSITORY")
    source = f"{server}/{repository}" if server and repository else _git(folder, "config", "--get", "remote.origin.url")
    revision = variables.get("GITHUB_SHA") or _git(folder, "rev-parse", "--verify", "--quiet", "HEAD")
    found = {SOURCE: _without_login(source), REVISION: revision}
    ours = {KEY_LABEL: key, SPECIFICATION_LABEL: specification}
    return {name: value for name, value in found.items() if value} | dict(user) | ours


def _git(folder: Path, *arguments: str) -> str:
    """Run git in a folder and return its output; empty if git or the repository is missing."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=SECONDS,
            check=False,
            stdin=subprocess.DEVNULL,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return one_line(done.stdout) if done.returncode == 0 else ""


def _without_login(url: str) -> str:
    """Remove user and password from a URL."""
    try:
        parts = urlsplit(url)
        if "@" not in parts.netloc:
            return url
        return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))
    except ValueError:
        return ""
