"""Requirements on frames in tf: known within a time, connected with another one, and fresh."""

from dataclasses import dataclass

from calibration.addons.requirements.message_fields import FieldTree
from calibration.addons.requirements.requirement import NS_PER_S, Judgement, Message, Requirement, duration
from calibration.addons.requirements.settings import FrameRequirements
from calibration.addons.requirements.topics import nanoseconds

TF_TOPIC, STATIC_TOPIC = "/tf", "/tf_static"
_TRANSFORMS: FieldTree = {
    "transforms": {"header": {"stamp": {}, "frame_id": {}}, "child_frame_id": {}},
}
MAX_FRAMES = 10_000
"""Limit of the frames of a bag that are followed."""


@dataclass(frozen=True, slots=True)
class _Link:
    """Newest transform of a frame."""

    parent: str
    stamp: int
    """Its stamp, ns; of a static one it does not count."""
    is_static: bool


class FrameRequirement(Requirement):
    """A frame is known within a time, and fresh from then on: its age is the time since the stamp of a transform.

    The frames from it up to the other one, or to the root, are followed; the age of each transform is looked at where
    the next one comes, and at the end.
    """

    def __init__(self, frame: str, of: FrameRequirements) -> None:
        target = f" to {of.to}" if of.to else ""
        limits = (("within", of.within), ("fresh to", of.max_age))
        text = " and ".join(f"{word} {duration(limit * NS_PER_S)}" for word, limit in limits if limit is not None)
        super().__init__(
            f"frame {frame}{target}",
            f"known {text}" if of.within is not None else text,
            {TF_TOPIC: _TRANSFORMS, STATIC_TOPIC: _TRANSFORMS},
            (("frames", frame), None),
        )
        self.frame = frame.strip("/")
        self.to = of.to.strip("/") if of.to else None
        self.within = None if of.within is None else round(of.within * NS_PER_S)
        self.max_age = None if of.max_age is None else round(of.max_age * NS_PER_S)
        self.links: dict[str, _Link] = {}
        self.known_since: int | None = None
        self.chain: frozenset[str] = frozenset()
        self.stale: tuple[str, int, int] | None = None
        """Frame whose transform was oldest, its age and when that was, ns."""

    def feed(self, message: Message) -> None:
        """Take the next message."""
        is_static = message.topic == STATIC_TOPIC
        changed = False
        for each in message.fields["transforms"]:
            child, parent = each["child_frame_id"].strip("/"), each["header"]["frame_id"].strip("/")
            old = self.links.get(child)
            if old is None and len(self.links) == MAX_FRAMES:
                continue
            if child in self.chain:
                self._look_at_age(child, message.time)
            self.links[child] = _Link(parent, nanoseconds(each["header"]["stamp"]), is_static)
            changed = changed or old is None or old.parent != parent
        if changed:
            chain = self._chain()
            self.chain = frozenset(chain or ())
            if chain is not None and self.known_since is None:
                self.known_since = message.time

    def close(self, end: int) -> Judgement:
        """Judge at the end of the bag."""
        if self.known_since is None:
            return self.not_met(f"it unknown until the bag ended after {self.seconds(end)}: {self._known_frames()}")
        if self.within is not None and self.known_since - self.begin > self.within:
            return self.not_met(f"it known after {self.seconds(self.known_since)}")
        for child in self.chain:
            self._look_at_age(child, end)
        if self.stale is not None:
            child, age, time = self.stale
            return self.not_met(f"the transform of {child} {duration(age)} old at {self.seconds(time)}")
        return self.met()

    def _chain(self) -> list[str] | None:
        """Return the frames from it upwards that have transforms; None if it is not connected, or in a circle."""
        found: list[str] = []
        frame = self.frame
        while frame != self.to and frame in self.links and len(found) <= len(self.links):
            found.append(frame)
            frame = self.links[frame].parent
        if len(found) > len(self.links) or (self.to is not None and frame != self.to):
            return None
        is_root = self.to is None and any(link.parent == self.frame for link in self.links.values())
        return found if found or is_root else None

    def _look_at_age(self, child: str, time: int) -> None:
        link = self.links[child]
        age = time - link.stamp
        if self.max_age is None or link.is_static or age <= self.max_age:
            return
        if self.stale is None or age > self.stale[1]:
            self.stale = child, age, time

    def _known_frames(self) -> str:
        names = sorted({*self.links, *(link.parent for link in self.links.values())})
        return f"known are {', '.join(names[:10])}{', ...' if len(names) > 10 else ''}" if names else "tf is empty"
