"""Containers as ``calibration.yml`` describes them."""

import os
from collections.abc import Mapping
from dataclasses import replace

from calibration.errors import InputError
from calibration.execution.job import Container


def with_secrets(container: Container, where: str, environment: Mapping[str, str] | None = None) -> Container:
    """The container with the values of its ``secrets`` among its variables.

    Args:
        container: as it was read.
        where: what messages begin with.
        environment: where the values are taken from; this process's own unless given.

    Raises:
        InputError: a secret is not set, or is a variable with another value too.
    """
    environment = os.environ if environment is None else environment
    for name in sorted(container.secrets):
        if not environment.get(name):
            raise InputError(f"{where}.secrets: the environment variable {name} is not set")
        if name in container.environment:
            raise InputError(f"{where}: {name} stands in environment and in secrets: its value belongs in neither file")
    secrets = {name: environment[name] for name in container.secrets}
    return replace(container, environment={**container.environment, **secrets})
