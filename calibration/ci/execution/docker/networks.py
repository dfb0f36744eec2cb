"""Private networks of the jobs of a run.

Creating and removing one takes a third of a second, so there are no more than needed to isolate jobs. Jobs with one
container share a network on which the engine blocks traffic between containers, and allows it only to the outside.
A job with several containers has its own network, which later jobs of the run reuse.
"""

import threading
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import docker.errors
from docker import APIClient

from calibration.base import CalibrationError, InfrastructureError
from calibration.ci.docker_engine import EngineLostError, engine_errors
from calibration.ci.execution.docker.labels import new_run

_NO_TALKING = {"com.docker.network.bridge.enable_icc": "false"}


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
