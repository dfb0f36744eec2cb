"""Labels of the origin of an image."""

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit, urlunsplit

from calibration.base.errors import CalibrationError
from calibration.ci.git.repository import Repository
from calibration.ci.image.content_key import KEY_LABEL, SPECIFICATION_LABEL
from calibration.ci.services import service_of

SOURCE_LABEL = "org.opencontainers.image.source"
REVISION_LABEL = "org.opencontainers.image.revision"


def build_labels(
    key: str, specification: str, user: Mapping[str, str], folder: Path, environment: Mapping[str, str] | None = None
) -> dict[str, str]:
    """Return the labels of an image that is built now: the user's, the keys, and the commit if it is known.

    An image that is found later, unchanged, keeps the commit of its build. There is no date, because
    images have a date of creation.
    """
    variables = os.environ if environment is None else environment
    source, revision = service_of(variables).origin(variables)
    if not (source and revision):
        with suppress(CalibrationError):  # no git, or no checkout
            checkout = Repository.around(folder)
            source = source or checkout.origin() or ""
            revision = revision or checkout.head() or ""
    found = {SOURCE_LABEL: _without_login(source), REVISION_LABEL: revision}
    ours = {KEY_LABEL: key, SPECIFICATION_LABEL: specification}
    return {name: value for name, value in found.items() if value} | dict(user) | ours


def _without_login(url: str) -> str:
    """Remove user and password from a URL."""
    try:
        parts = urlsplit(url)
        if "@" not in parts.netloc:
            return url
        return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))
    except ValueError:
        return ""
