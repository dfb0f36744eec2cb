"""Conversion of a container to the engine's settings, with all privileges dropped by default."""

from collections.abc import Mapping
from typing import Any

from docker import APIClient
from docker.types import DeviceRequest, LogConfig, Mount

from calibration.ci.execution.docker.networks import Network
from calibration.ci.execution.job import OUTPUT, Container

DEFAULT_BRIDGE = "bridge"
"""Default network of the engine."""
_DOCKER_SOCKET = "/var/run/docker.sock"
_STOP_SECONDS = 5


def container_settings(
    api: APIClient, container: Container, network: Network | str, volume: str, labels: Mapping[str, str], binds: bool
) -> dict[str, Any]:
    """Return the arguments that create a container, except for name and image.

    Args:
        api: client, for parts that depend on the engine's version.
        container: the container.
        network: its network, or a network mode of the engine.
        volume: name of the job's volume.
        labels: labels of the run, the job and the container.
        binds: whether the engine can access our file system; otherwise mounts are copied later.
    """
    relaxed = container.relaxations
    mounts = [Mount(OUTPUT, volume, type="volume", no_copy=True)]
    if binds:
        mounts += [
            Mount(mount.target, str(mount.source.resolve()), type="bind", read_only=not mount.writable)
            for mount in container.mounts
        ]
    if relaxed.docker_socket:
        mounts.append(Mount(_DOCKER_SOCKET, _DOCKER_SOCKET, type="bind"))
    limits = container.limits
    host: dict[str, Any] = {
        "init": True,  # forwards signals and reaps zombies
        "network_mode": network if isinstance(network, str) else network.name,
        "mounts": mounts,
        "cap_add": list(relaxed.capabilities),
        "devices": list(relaxed.devices),
        "pids_limit": limits.processes,
        "log_config": LogConfig(type="none"),  # read while it runs; the engine stores nothing, because of secrets
        "privileged": relaxed.privileged,
    }
    if not relaxed.privileged:
        host["cap_drop"] = ["ALL"]
        if not relaxed.new_privileges:
            host["security_opt"] = ["no-new-privileges:true"]
    if limits.memory is not None:
        host |= {"mem_limit": limits.memory, "memswap_limit": limits.memory}
    if limits.cpus is not None:
        host["nano_cpus"] = round(limits.cpus * 1e9)
    if relaxed.gpus:
        host["device_requests"] = [DeviceRequest(count=-1, capabilities=[["gpu"]])]
    settings: dict[str, Any] = {
        "command": list(container.command) or None,
        "environment": dict(container.environment),
        "labels": dict(labels),
        "host_config": api.create_host_config(**host),
        "stop_timeout": _STOP_SECONDS,
    }
    if container.entrypoint is not None:
        settings["entrypoint"] = list(container.entrypoint) or [""]  # the engine's notation for none
    if container.working_directory is not None:
        settings["working_dir"] = container.working_directory
    if container.user is not None:
        settings["user"] = container.user
    if network != "host":
        settings["hostname"] = container.name
    if isinstance(network, Network) and not network.shared:
        endpoint = api.create_endpoint_config(aliases=[container.name])
        settings["networking_config"] = {"EndpointsConfig": {network.name: endpoint}}
    return settings
