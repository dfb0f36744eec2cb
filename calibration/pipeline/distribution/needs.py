"""What became of the jobs that the last job of a workflow waits for."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from calibration.errors import InputError

SUCCESS = "success"


@dataclass(frozen=True)
class Needs:
    """The jobs before, as GitHub tells of them (``toJSON(needs)``)."""

    results: Mapping[str, str] = field(default_factory=dict)
    """For each job success, failure, cancelled or skipped."""
    plan: Mapping[str, Any] = field(default_factory=dict)
    """The outputs of the job plan; empty where it failed."""


def parse_needs(text: str) -> Needs:
    """Read ``toJSON(needs)``.

    Raises:
        InputError: it is none, or has no job plan.
    """
    try:
        jobs = json.loads(text)
        results = {name: str(job["result"]) for name, job in jobs.items()}
        plan = dict(jobs["plan"]["outputs"] or {})
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError("needs: ${{ toJSON(needs) }} of a job that waits for the job plan was expected") from None
    return Needs(results, plan)
