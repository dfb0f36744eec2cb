"""The secrets of a build: read where the specification says, hidden from the log, given to BuildKit as files."""

import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from calibration.errors import InputError
from calibration.files import read_bytes
from calibration.image.specification import Secret
from calibration.workflow import Runner, add_mask

MAX_BYTES = 500 * 1024
"""As much as BuildKit takes."""
SHORTEST = 6
"""Characters; a shorter one may stand in a text by chance."""


@dataclass(frozen=True)
class SecretValue:
    """A secret that has been read."""

    id: str
    value: bytes = field(repr=False)

    @property
    def text(self) -> str:
        """As it may appear in a text."""
        return self.value.decode("utf-8", "surrogateescape")


def read_secrets(
    secrets: Iterable[Secret], runner: Runner, environment: Mapping[str, str] | None = None
) -> tuple[SecretValue, ...]:
    """Read the secrets, and mask each before anything else is printed.

    Raises:
        InputError: a variable is not set or empty, or a file cannot be read; names it.
    """
    variables = os.environ if environment is None else environment
    values = []
    for secret in secrets:
        if secret.file is not None:
            value = read_bytes(secret.file, MAX_BYTES, f"the secret {secret.id}")
        else:
            value = os.fsencode(variables.get(secret.variable or "", ""))
        if not value.strip():
            source = secret.file or f"the environment variable {secret.variable}"
            raise InputError(f"secrets: {secret.id}: {source} is not set or empty, where the secret was expected")
        values.append(SecretValue(secret.id, value))
        add_mask(runner, values[-1].text)
    return tuple(values)


def refuse_secrets_in(secrets: Iterable[SecretValue], places: Mapping[str, str]) -> None:
    """Make sure that no secret stands where the image would show it.

    Raises:
        InputError: one does; names the secret and the place, not the value.
    """
    for secret in secrets:
        text = secret.text.strip()
        for place, content in places.items():
            if len(text) >= SHORTEST and text in content:
                raise InputError(
                    f"secrets: {secret.id}: its value stands in {place}, where everyone who has the image reads it: "
                    f"take it out, and let the command read /run/secrets/{secret.id}"
                )


@contextmanager
def secret_files(secrets: Iterable[SecretValue]) -> Iterator[dict[str, Path]]:
    """Give each secret as a file that only this user can read, gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="calibration-") as folder:  # mode 0700
        files = {}
        for number, secret in enumerate(secrets):
            files[secret.id] = Path(folder, str(number))
            with os.fdopen(os.open(files[secret.id], os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(secret.value)
        yield files
