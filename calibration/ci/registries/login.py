"""Registry credentials from the settings, from AWS, or from ``docker login``."""

import os
from collections.abc import Mapping

from docker import auth, errors

from calibration.base import InfrastructureError, InputError, one_line, shorten
from calibration.base.addons import import_attribute, of_addons
from calibration.ci.registries.reference import DOCKER_HUB, Credentials, RegistrySettings, is_ecr, parse_reference
from calibration.ci.workflow import Runner, add_mask


def registry_login(
    settings: RegistrySettings | None, name: str, runner: Runner, environment: Mapping[str, str] | None = None
) -> Credentials:
    """Find the credentials of an image's registry, and mask their secrets.

    Sources, in this order: user and variable in the settings; AWS, if the settings name it;
    docker's configuration (``docker login`` and credential helpers); AWS, if the registry is one of AWS's; none.
    The credentials are passed with each call, never written to a file.

    Args:
        settings: settings of the registry; None for the defaults.
        name: name of the image, with or without tag.
        runner: runner that masks the secrets.
        environment: environment variables; by default those of the process.

    Raises:
        InputError: the settings are not complete, the variable is not set, or AWS denies it.
        InfrastructureError: AWS cannot be reached, or docker's credential helper fails.
    """
    settings = settings or RegistrySettings()
    registry = parse_reference(name).registry
    credentials = _find_credentials(
        settings, name, registry, runner, os.environ if environment is None else environment
    )
    for secret in credentials.secrets:
        add_mask(runner, secret)
    return credentials


def _find_credentials(
    settings: RegistrySettings, name: str, registry: str, runner: Runner, environment: Mapping[str, str]
) -> Credentials:
    if settings.username or settings.password_variable:
        return _from_settings(settings, registry, environment)
    if settings.kind is None and (known := _from_docker(registry, settings.insecure)) is not None:
        return known
    if (kind := settings.kind or ("ecr" if is_ecr(registry) else None)) is not None:
        logins = of_addons(lambda addon: addon.registry_logins)
        if kind not in logins:
            raise InputError(
                f"{registry}: no add-on for registries of kind {kind} is installed: log in with docker login, or give "
                "username and password-variable"
            )
        found: Credentials = import_attribute(logins[kind])(name, runner, settings.create_repository, settings.insecure)
        return found
    return Credentials(registry, insecure=settings.insecure)


def _from_settings(settings: RegistrySettings, registry: str, environment: Mapping[str, str]) -> Credentials:
    variable = settings.password_variable
    if not settings.username or not variable:
        missing = "password-variable" if settings.username else "username"
        raise InputError(f"registry: {missing} is not given: username and password-variable belong together")
    password = environment.get(variable, "").strip()
    if not password:
        raise InputError(
            f"registry: the environment variable {variable} is not set or empty, "
            f"where the password of {settings.username} at {registry} was expected"
        )
    return Credentials(registry, settings.username, password, insecure=settings.insecure)


def _from_docker(registry: str, insecure: bool) -> Credentials | None:
    """Return the credentials for a registry in docker's configuration; None if it has none."""
    try:
        found = auth.load_config().resolve_authconfig(None if registry == DOCKER_HUB else registry)
    except errors.DockerException as error:
        raise InfrastructureError(
            f"{registry}: docker's own login cannot be read: {shorten(one_line(str(error)), 200)}"
        ) from None
    except (ValueError, TypeError, AttributeError, UnicodeError):
        raise InputError(
            f"{registry}: docker's config.json cannot be read: log in again with docker login, or mend the file"
        ) from None
    values = {name.lower(): value for name, value in (found or {}).items()}
    if values.get("identitytoken"):
        return Credentials(registry, identity_token=values["identitytoken"], insecure=insecure)
    if values.get("username") and values.get("password"):
        return Credentials(registry, values["username"], values["password"], insecure=insecure)
    return None
