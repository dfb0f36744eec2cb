"""Delivery of a run's bundle to some destinations: its version and changelog, all staged before any is seen."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from calibration.addons.delivery.archive import RefusedBundleError
from calibration.addons.delivery.bundling import Bundle
from calibration.addons.delivery.changes import (
    FIRST_VERSION,
    BundleContents,
    Change,
    Level,
    changelog_text,
    changes_between,
    level_of,
    next_version,
    read_contents,
)
from calibration.addons.delivery.destinations import Delivery, Destination
from calibration.addons.delivery.fetching import FetchedBundle
from calibration.addons.delivery.manifest import version_order
from calibration.base.errors import CalibrationError, InputError
from calibration.engine.baseline.quality import SameData


@dataclass(frozen=True)
class DeliveredBundle:
    """What was delivered, and where."""

    contents: BundleContents
    level: Level
    """By how much it differs from what was delivered before; none if it is that bundle."""
    to: tuple[str, ...]
    """The destinations that it was delivered to; those that had it are left out."""
    changelog: str
    later: bool = False
    """Whether a later commit has been delivered already, and therefore nothing was."""


def deliver_bundle(
    bundle: Bundle,
    destinations: Sequence[Destination],
    version: str | None,
    same_data: SameData,
    sign: Callable[[Bundle], bytes | None],
) -> DeliveredBundle:
    """Deliver a bundle, with the version that follows from what changed since the last one.

    What has not changed keeps its version and its bytes; destinations without them get these.

    Args:
        bundle: the bundle, of any version.
        destinations: in the order in which they show it.
        version: its version; None for the one that follows.
        same_data: tolerances of a result on the same data.
        sign: writes a bundle, and returns its attestation.

    Raises:
        InputError: a destination has other things than deliveries of this robot, or does not allow it.
        InfrastructureError: a destination cannot be reached, or another delivery was faster.
    """
    earlier = [_last_contents(destination) for destination in destinations]
    last = max((each for each in earlier if each), key=lambda each: version_order(each.manifest.version), default=None)
    now = read_contents(FetchedBundle("bundle", bundle.content, None))
    level: Level = "major" if last is None else level_of(_changes(last, now, same_data))
    if last is not None and level != "none" and now.manifest.made < last.manifest.made:
        return DeliveredBundle(last, "none", (), "", later=True)
    if last is None or level != "none":
        chosen = version or (FIRST_VERSION if last is None else next_version(last.manifest.version, level))
        if last is not None and version_order(chosen) <= version_order(last.manifest.version):
            raise InputError(f"version: found {chosen}, expected a larger one than {last.manifest.version}, the last")
        versioned = bundle.with_version(chosen)
        last = read_contents(FetchedBundle("bundle", versioned.content, sign(versioned)))
    content = last.fetched.content
    lacking = [
        (destination, before)
        for destination, before in zip(destinations, earlier, strict=True)
        if before is None or before.fetched.content != content
    ]
    changelogs = [
        changelog_text(last.manifest, None, [])
        if before is None
        else changelog_text(last.manifest, before.manifest, _changes(before, last, same_data))
        for _, before in lacking
    ]
    deliveries = [Delivery(last.manifest, content, last.fetched.attestation, each) for each in changelogs]
    _deliver_to_all([destination for destination, _ in lacking], deliveries)
    return DeliveredBundle(last, level, tuple(each.name for each, _ in lacking), changelogs[0] if lacking else "")


def _last_contents(destination: Destination) -> BundleContents | None:
    found = destination.last()
    return None if found is None else read_contents(found)


def _changes(before: BundleContents, now: BundleContents, same_data: SameData) -> list[Change]:
    try:
        return changes_between(before, now, same_data)
    except RefusedBundleError as error:
        raise InputError(f"{before.fetched.where}: {error}: a robot has a destination of its own") from None


def _deliver_to_all(destinations: Sequence[Destination], deliveries: Sequence[Delivery]) -> None:
    """Stage all deliveries, then complete them; what was not completed is withdrawn."""
    completed: list[str] = []
    try:
        for destination, delivery in zip(destinations, deliveries, strict=True):
            destination.stage(delivery)
        for destination in destinations:
            destination.complete()
            completed.append(destination.name)
    except BaseException as error:
        for destination in destinations[len(completed) :]:
            with suppress(CalibrationError):  # the first error is told
                destination.withdraw()
        if completed and isinstance(error, CalibrationError):
            raise type(error)(f"{error}; delivered already to {', '.join(completed)}: run it again") from None
        raise
