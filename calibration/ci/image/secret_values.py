"""Secrets of a build: read, masked in the log, and passed to BuildKit as files."""

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from calibration.base.errors import InputError
from calibration.base.files import read_bytes, temporary_folder
from calibration.ci.image.specification import Secret
from calibration.ci.workflow import Runner, add_mask

MAX_BYTES = 500 * 1024
"""BuildKit's limit."""
MIN_SEARCHED_CHARACTERS = 6
"""Minimum length in characters to search for; a shorter secret may occur in a text by chance."""


@dataclass(frozen=True)
class SecretValue:
    """A secret with its value."""

    id: str
    value: bytes = field(repr=False)

    @property
    def text(self) -> str:
        """The value as text."""
        return self.value.decode("utf-8", "surrogateescape")


def read_secrets(
    secrets: Iterable[Secret], runner: Runner, environment: Mapping[str, str] | None = None
) -> tuple[SecretValue, ...]:
    """Read the secrets, and mask them before any other output.

    Raises:
        InputError: a variable is unset or empty, or a file cannot be read; the message names it.
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
    """Check that no secret occurs in texts that become part of the image.

    Raises:
        InputError: one does; the message names the secret and the place, not the value.
    """
    for secret in secrets:
        text = secret.text.strip()
        for place, content in places.items():
            if len(text) >= MIN_SEARCHED_CHARACTERS and text in content:
                raise InputError(
                    f"secrets: {secret.id}: its value occurs in {place}, which everyone with the image can read: "
                    f"remove it, and let the command read /run/secrets/{secret.id}"
                )


@contextmanager
def secret_files(secrets: Iterable[SecretValue]) -> Iterator[dict[str, Path]]:
    """Write each secret to a file that only this user can read, removed at the end of the block."""
    with temporary_folder() as folder:  # mode 0700
        files = {}
        for number, secret in enumerate(secrets):
            files[secret.id] = folder / str(number)
            with os.fdopen(os.open(files[secret.id], os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(secret.value)
        yield files
