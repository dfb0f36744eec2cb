"""Tags on all that runs: of which run it is, and who started it."""

from collections.abc import Mapping
from dataclasses import replace

from calibration.execution.docker.labels import RUN, Owner


def run_tags(run: str) -> dict[str, str]:
    """The tags of the jobs of a run that this process starts."""
    return {RUN: run, **_plain(Owner.this_process()).labels}


def owner_of(tags: Mapping[str, str]) -> Owner | None:
    """Who started a job; None where the tags do not say."""
    owner = Owner.from_labels(tags)
    if owner is None:
        return None
    kind, colon, number = owner.namespace.partition(":")
    return replace(owner, namespace=f"{kind}:[{number}]" if colon else owner.namespace)


def _plain(owner: Owner) -> Owner:
    """Without the brackets around the number of a namespace, which no tag in AWS may have."""
    return replace(owner, namespace=owner.namespace.replace("[", "").replace("]", "") or "unknown")
