"""What became of the jobs of a workflow, and how long each took, as the job itself says it."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calibration.errors import CalibrationError, InputError
from calibration.files import read_bytes

SUCCESS = "success"
UNPLANNED = ("coverage",)
SECONDS = "seconds"
"""The output by which a job that is alone in its place tells how long it took."""
FILE = "job-seconds.txt"
"""Beside the results of a job of the matrix, of which GitHub keeps no outputs one by one."""
_SECONDS = re.compile(r"[0-9]{1,7}")
"""No job runs for longer than 115 days."""


@dataclass(frozen=True)
class Needs:
    """The jobs before, as GitHub tells of them (``toJSON(needs)``)."""

    results: Mapping[str, str] = field(default_factory=dict)
    """For each job success, failure, cancelled or skipped."""
    plan: Mapping[str, Any] = field(default_factory=dict)
    """The outputs of plan-matrix; empty where it failed."""
    seconds: Mapping[str, int] = field(default_factory=dict)
    """How long the jobs took that say it by an output."""

    @property
    def unplanned(self) -> dict[str, str]:
        """The results of jobs that are not in the plan, because other inputs of the workflow decide about them."""
        return {job: self.results[job] for job in UNPLANNED if job in self.results}


def parse_needs(text: str) -> Needs:
    """Read ``toJSON(needs)``.

    Raises:
        InputError: it is none, or has no job plan.
    """
    try:
        jobs = json.loads(text)
        results = {name: str(job["result"]) for name, job in jobs.items()}
        outputs = {name: dict(job.get("outputs") or {}) for name, job in jobs.items()}
        plan = dict(jobs["plan"]["outputs"] or {})
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise InputError("needs: ${{ toJSON(needs) }} of a job that waits for the job plan was expected") from None
    plan.pop(SECONDS, None)
    told = {name: parse_seconds(found.get(SECONDS)) for name, found in outputs.items()}
    return Needs(results, plan, {name: seconds for name, seconds in told.items() if seconds is not None})


def parse_seconds(value: object) -> int | None:
    """The seconds that a job says; None for anything else, which is no reason to fail."""
    text = value.strip() if isinstance(value, str) else ""
    return int(text) if _SECONDS.fullmatch(text) else None


def read_seconds(folder: Path) -> int | None:
    """What a job has left in its folder; None where it has left nothing, or something else."""
    try:
        return parse_seconds(read_bytes(folder / FILE, 16, "a number of seconds").decode("latin-1"))
    except CalibrationError:
        return None
