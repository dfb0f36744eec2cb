"""A container of the job model as the engine wants it: everything is forbidden that is not asked for."""

from collections.abc import Mapping
from typing import Any

from docker import APIClient
from docker.types import DeviceRequest, LogConfig, Mount

from calibration.execution.docker.networks import Network
from calibration.execution.job import OUTPUT, Container

DEFAULT_BRIDGE = "bridge"
"""The engine's network for containers that ask for none."""
_SOCKET = "/var/run/docker.sock"
_GRACE = 5


def container_settings(
    api: APIClient, container: Container, network: Network | str, volume: str, labels: Mapping[str, str], binds: bool
) -> dict[str, Any]:
    """The arguments that create a container, but for its name and image.

    Args:
        api: makes the parts that depend on the engine's version.
        container: the container.
        network: that it is on, or one of the engine's modes.
        volume: the name of the job's volume.
        labels: of the run, the job and the container.
        binds: whether the engine sees our files; else they are copied in later.
    """
    relaxed = container.relaxations
    mounts = [Mount(OUTPUT, volume, type="volume", no_copy=True)]
    if binds:
        mounts += [
            Mount(mount.target, str(mount.source.resolve()), type="bind", read_only=not mount.writable)
            for mount in container.mounts
        ]
    if relaxed.docker_socket:
        mounts.append(Mount(_SOCKET, _SOCKET, type="bind"))
    limits = container.limits
    host: dict[str, Any] = {
        "init": True,  # hands signals on, and buries the dead
        "network_mode": network if isinstance(network, str) else network.name,
        "mounts": mounts,
        "cap_add": list(relaxed.capabilities),
        "devices": list(relaxed.devices),
        "pids_limit": limits.processes,
        "log_config": LogConfig(type="none"),  # we read along; the engine keeps nothing, secrets neither
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
        "stop_timeout": _GRACE,
    }
    if container.entrypoint is not None:
        settings["entrypoint"] = list(container.entrypoint) or [""]  # the engine's word for none
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
