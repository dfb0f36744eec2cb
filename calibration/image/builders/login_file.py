"""A login for a ``docker`` program, which takes none but from a file."""

import base64
import json
import os
from pathlib import Path

from calibration.registries.credentials import Credentials
from calibration.registries.reference import DOCKER_HUB


def write_login(credentials: Credentials, folder: Path) -> dict[str, str]:
    """Write docker's configuration with a login into a folder, for this user alone.

    Args:
        credentials: for one registry; where there are none, the user's own configuration counts.
        folder: private, and removed by whoever made it.

    Returns:
        The variables that make a ``docker`` use it; its plugins are still found.
    """
    if credentials.anonymous:
        return {}
    registry = "https://index.docker.io/v1/" if credentials.registry == DOCKER_HUB else credentials.registry
    if credentials.identity_token:
        login = {"identitytoken": credentials.identity_token}
    else:
        pair = f"{credentials.username}:{credentials.password}"
        login = {"auth": base64.b64encode(pair.encode()).decode("ascii")}
    home = folder / "docker"
    home.mkdir(mode=0o700)
    with os.fdopen(os.open(home / "config.json", os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        json.dump({"auths": {registry: login}}, file)
    plugins = Path(os.environ.get("DOCKER_CONFIG") or Path("~/.docker").expanduser()) / "cli-plugins"
    if plugins.is_dir():
        (home / "cli-plugins").symlink_to(plugins)
    return {"DOCKER_CONFIG": str(home)}
