"""Objects of runs on a Docker Engine: the private networks of jobs, and what was not removed, found by its labels.

Creating and removing a network takes a third of a second, so there are no more than needed to isolate jobs. Jobs with
one container share a network on which the engine blocks traffic between containers, and allows it only to the outside.
A job with several containers has its own network, which later jobs of the run reuse.
"""

import threading
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

import docker.errors
from docker import APIClient

from calibration.base import CalibrationError, InfrastructureError, count_of
from calibration.ci.docker_engine import EngineLostError, connect, engine_errors, engine_message
from calibration.ci.execution.docker.labels import CONTAINER_LABEL, JOB_LABEL, RUN_LABEL, Owner, new_run

_NO_TALKING = {"com.docker.network.bridge.enable_icc": "false"}
Kind = Literal["container", "network", "volume"]


@dataclass(frozen=True)
class Network:
    """A network of a job."""

    name: str
    internal: bool
    """Whether it has no connection to the outside."""
    shared: bool
    """Whether other jobs use it, which are unreachable."""


class Networks:
    """Networks of a run. Thread-safe."""

    def __init__(self, run: str, labels: Mapping[str, str]) -> None:
        self._run = run
        self._labels = dict(labels)
        self._free: dict[bool, list[Network]] = defaultdict(list)
        self._shared: dict[bool, Network | None] = {}
        self._lock = threading.Lock()

    def shared(self, api: APIClient, internal: bool) -> Network:
        """Return the network for jobs with one container; a separate one if the engine cannot isolate containers.

        Raises:
            InfrastructureError: the engine cannot create it, or does not answer.
        """
        with self._lock:
            if internal not in self._shared:
                try:
                    self._shared[internal] = self._make_network(api, internal, shared=True)
                except EngineLostError:
                    raise
                except CalibrationError:  # raised for kernels without br_netfilter
                    self._shared[internal] = None
            found = self._shared[internal]
        return found or self.take(api, internal)

    def take(self, api: APIClient, internal: bool) -> Network:
        """Return an unused network.

        Raises:
            InfrastructureError: the engine cannot create one, or does not answer.
        """
        with self._lock:
            if self._free[internal]:
                return self._free[internal].pop()
        return self._make_network(api, internal, shared=False)

    def give_back(self, network: Network) -> None:
        """Release a network that a job does not use any more."""
        if not network.shared:
            with self._lock:
                self._free[network.internal].append(network)

    def _make_network(self, api: APIClient, internal: bool, shared: bool) -> Network:
        network = Network(f"calibration-{self._run}-{new_run()}", internal, shared)
        options = _NO_TALKING if shared else {}
        with engine_errors("network"):
            try:
                api.create_network(network.name, "bridge", options, internal=internal, labels=self._labels)
            except docker.errors.APIError as error:
                if "address pool" in str(error):
                    raise InfrastructureError(
                        "the Docker Engine has no addresses for one more network: run fewer jobs at once, "
                        "or remove unused networks (docker network prune)"
                    ) from None
                raise
        return network


@dataclass(frozen=True)
class Leftover:
    """An object on the engine that a run has created."""

    kind: Kind
    id: str
    name: str
    run: str
    job: str
    """Empty for a network, which several jobs use."""
    container: str
    state: str
    owner: Owner | None
    """Owner by the labels; None if the labels do not contain one."""

    @property
    def row(self) -> tuple[str, ...]:
        """Cells of a table's row."""
        return (self.kind, self.name, self.run, self.job, self.state)

    @classmethod
    def of(cls, kind: Kind, identifier: str) -> Self:
        """Return a leftover from an id known to its creator, without a search."""
        return cls(kind, identifier, identifier, run="", job="", container="", state="", owner=None)


def find_leftovers(api: APIClient, run: str | None = None) -> list[Leftover]:
    """Find objects of a run, or of all runs, on the engine, in an order in which they can be removed.

    Raises:
        InfrastructureError: the engine does not answer.
    """
    chosen = {"label": [RUN_LABEL if run is None else f"{RUN_LABEL}={run}"]}
    with engine_errors():
        containers = api.containers(all=True, filters=chosen)
        networks = api.networks(filters=chosen)
        volumes = api.volumes(filters=chosen)["Volumes"] or []
    return [
        *(_leftover_of("container", c["Id"], (c.get("Names") or [c["Id"][:12]])[0].lstrip("/"), c) for c in containers),
        *(_leftover_of("network", n["Id"], n["Name"], n) for n in networks),
        *(_leftover_of("volume", v["Name"], v["Name"], v) for v in volumes),
    ]


def remove(api: APIClient, leftovers: Sequence[Leftover]) -> list[Leftover]:
    """Remove objects, including running containers; those already gone are no error.

    Returns:
        Removed objects, including those removed by others meanwhile.

    Raises:
        InfrastructureError: an object cannot be removed (the others have been), or the engine does not answer.
    """
    removed, problems = [], []
    # containers first: networks and volumes in use cannot be removed
    for leftover in sorted(leftovers, key=lambda leftover: leftover.kind):
        with engine_errors():
            try:
                _remove_leftover(api, leftover)
            except docker.errors.NotFound:
                pass
            except docker.errors.APIError as error:
                if "is already in progress" not in str(error):
                    problems.append(f"{leftover.kind} {leftover.name}: {engine_message(error)}")
                    continue
        removed.append(leftover)
    if problems:
        raise InfrastructureError(f"cannot be removed: {'; '.join(problems[:5])}")
    return removed


def remove_of_dead_runs(api: APIClient) -> list[Leftover]:
    """Remove what runs have left whose processes were killed since this machine was started.

    Other machines may have its name and use the same engine: there a process of another start may be alive.

    Raises:
        InfrastructureError: an object cannot be removed (the others have been), or the engine does not answer.
    """
    boot = Owner.this_process().boot
    owned = [(each, each.owner) for each in find_leftovers(api) if each.owner is not None]
    return remove(api, [each for each, owner in owned if owner.boot == boot and owner.is_dead])


def counts_of(leftovers: Iterable[Leftover]) -> str:
    """Return the number of objects of each kind, in words; ``nothing`` for none."""
    kinds = [leftover.kind for leftover in leftovers]
    counts = [count_of(kinds.count(kind), kind) for kind in dict.fromkeys(kinds)]
    return ", ".join(counts) or "nothing"


def _remove_leftover(api: APIClient, leftover: Leftover) -> None:
    if leftover.kind == "container":
        api.remove_container(leftover.id, force=True, v=True)
    elif leftover.kind == "network":
        api.remove_network(leftover.id)
    else:
        api.remove_volume(leftover.id)


def _leftover_of(kind: Kind, identifier: str, name: str, record: Any) -> Leftover:
    labels = record.get("Labels") or {}
    return Leftover(
        kind=kind,
        id=identifier,
        name=name,
        run=labels.get(RUN_LABEL, ""),
        job=labels.get(JOB_LABEL, ""),
        container=labels.get(CONTAINER_LABEL, ""),
        state=record.get("State", "") if kind == "container" else "",
        owner=Owner.from_labels(labels),
    )


class EngineLeftovers:
    """Leftovers of runs on the Docker Engine of this machine."""

    header = ("what", "name", "run", "job", "state")

    def __enter__(self) -> Self:
        """Connect to the engine.

        Raises:
            InfrastructureError: no engine answers.
        """
        self._client = connect()
        return self

    def __exit__(self, *_: object) -> None:
        """Close the connection."""
        self._client.close()

    def find(self, run: str | None) -> list[Leftover]:
        """Find leftovers of a run, or of all runs."""
        return find_leftovers(self._client.api, run)

    def remove(self, chosen: Sequence[Leftover]) -> None:
        """Remove leftovers, including running containers."""
        remove(self._client.api, chosen)

    def summary(self, chosen: Sequence[Leftover], dry_run: bool) -> str:
        """Return the number of removed objects of each kind, as a sentence."""
        return f"{counts_of(chosen)} {'would be removed' if dry_run else 'removed'}"
