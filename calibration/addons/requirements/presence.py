"""Requirements that nodes and services are seen in a bag."""

from collections.abc import Collection

from calibration.addons.requirements.message_fields import FieldTree
from calibration.addons.requirements.requirement import Judgement, Message, Requirement
from calibration.base.errors import InputError

_NAME_OF_TOPIC: dict[str, str] = {"/rosout": "name", "/parameter_events": "node"}
"""Topics whose messages name a node, with the field that does."""
_EVENT_TOPIC = "/_service_event"


class NodeSeen(Requirement):
    """A node is seen: as a publisher of a ROS 1 bag, in /rosout, or in /parameter_events."""

    def __init__(self, node: str, callers: Collection[str], topics: Collection[str]) -> None:
        wanted: dict[str, FieldTree] = {topic: {name: {}} for topic, name in _NAME_OF_TOPIC.items() if topic in topics}
        super().__init__(f"node {node}", "to see it", wanted, (("nodes",), node))
        self.node = _plain(node)
        self.is_seen = self.node in {_plain(name) for name in callers}
        self.looked_at = bool(callers or wanted)

    def feed(self, message: Message) -> None:
        """Look at the node that a message names; in /rosout of ROS 2 dots are between namespaces."""
        if not self.is_seen:
            name = _plain(str(message.fields[_NAME_OF_TOPIC[message.topic]]))
            self.is_seen = self.node in (name, name.replace(".", "/"))

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        if self.is_seen:
            return self.met()
        return self.not_met("it nowhere" if self.looked_at else "nothing that names nodes: record /rosout too")


class ServiceSeen(Requirement):
    """A service of ROS 2 is called: its introspection publishes an event."""

    def __init__(self, service: str, ros: int) -> None:
        if ros == 1:
            raise InputError(f"requirements.services: found {service}, but a bag of ROS 1 has no calls of services")
        super().__init__(
            f"service {service}", "a call of it", {f"/{_plain(service)}{_EVENT_TOPIC}": {}}, (("services",), service)
        )
        self.is_seen = False

    def feed(self, message: Message) -> None:
        """Take an event of the service."""
        self.is_seen = True

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        return self.met() if self.is_seen else self.not_met("none: is its introspection configured?")


def _plain(name: str) -> str:
    return name.strip("/")
