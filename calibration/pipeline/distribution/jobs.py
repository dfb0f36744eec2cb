"""Results of a workflow's jobs, and their durations as reported by themselves."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from calibration.base.errors import CalibrationError, InputError
from calibration.base.files import read_bytes

SUCCESS = "success"
UNPLANNED = ("coverage",)
"""Jobs that plan-matrix does not plan, as other inputs of the workflow control them."""
SECONDS = "seconds"
"""Output with the duration, of a job without a matrix."""
ERROR = "error"
"""Output with the line of an error (`calibration.ci.workflow`), of a job that leaves no results."""
FILE = "job-seconds.txt"
"""File with the duration, beside the results of a job of the matrix, whose outputs GitHub does not keep one by one."""
_SECONDS = re.compile(r"[0-9]{1,7}")
"""Durations of up to 115 days."""


@dataclass(frozen=True)
class Needs:
    """Results of the previous jobs."""

    results: Mapping[str, str] = field(default_factory=dict)
    """Result of each job: success, failure, cancelled or skipped."""
    seconds: Mapping[str, int] = field(default_factory=dict)
    """Durations of the jobs that report them by an output."""
    errors: Mapping[str, str] = field(default_factory=dict)
    """Error lines of the jobs that leave no results, and report them by an output."""

    @property
    def unplanned(self) -> dict[str, str]:
        """Results of the jobs that are not in the plan."""
        return {job: self.results[job] for job in UNPLANNED if job in self.results}


def parse_needs(text: str) -> Needs:
    """Parse the JSON of the previous jobs: an object with the result of each, and with its outputs seconds and error.

    Raises:
        InputError: it is invalid, or has no job plan.
    """
    try:
        jobs = json.loads(text)
        results = {name: str(job["result"]) for name, job in jobs.items()}
        seconds = {name: found for name, job in jobs.items() if (found := parse_seconds(job.get(SECONDS))) is not None}
        errors = {name: str(job[ERROR]) for name, job in jobs.items() if job.get(ERROR)}
        _ = results["plan"]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise InputError(
            'needs: an object with every job was expected, {"plan": {"result": "success", "seconds": "7"}, ...}'
        ) from None
    return Needs(results, seconds, errors)


def parse_seconds(value: object) -> int | None:
    """Parse the seconds that a job reports; None if invalid, which is not an error."""
    text = value.strip() if isinstance(value, str) else ""
    return int(text) if _SECONDS.fullmatch(text) else None


def read_seconds(folder: Path) -> int | None:
    """Read the duration in a job's folder; None if it is missing or invalid."""
    try:
        return parse_seconds(read_bytes(folder / FILE, 16, "a number of seconds").decode("latin-1"))
    except CalibrationError:
        return None
