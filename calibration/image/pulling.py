"""An image that others have built, from its registry to the engine."""

from contextlib import closing

from calibration.image.bases import fetch
from calibration.image.builders.build_log import BuildLog
from calibration.registries.credentials import RegistrySettings
from calibration.registries.login import registry_login
from calibration.workflow import Runner, group, stop_commands
from calibration.workflow.progress import progress


def pull_image(name: str, settings: RegistrySettings, runner: Runner, title: str) -> None:
    """Pull an image as the user of the settings, unless the engine has it.

    Args:
        name: of the image; the login is for its registry, and for no other.
        settings: who one is there.
        runner: takes the log.
        title: of the progress.

    Raises:
        InputError: there is no such image, or it may not be seen.
        WorldError: the engine or the registry cannot be reached.
    """
    from calibration.docker.engine import connect, engine_errors

    credentials = registry_login(settings, name, runner)
    with (
        closing(connect()) as client,
        engine_errors(f"image '{name}'"),
        group(runner, f"{title}: {name}"),
        stop_commands(runner),
        progress(runner, title) as advance,
    ):
        log = BuildLog(runner, advance, credentials.secrets)
        fetch(client, name, lambda _: credentials, None, log)
