"""Plan as outputs of a workflow job for the jobs that follow, and as a file in an artifact for the last one."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from calibration.base.errors import InfrastructureError, InputError
from calibration.base.files import read_bytes
from calibration.base.text import number_text
from calibration.pipeline.distribution.plan import PLAN_SLUG, JobCell, WorkflowPlan

MAX_OUTPUT_BYTES = 400 * 1024
"""Limit of all outputs: GitHub takes 1 MB from a job, and counts two bytes for a character."""


def plan_outputs(plan: WorkflowPlan) -> dict[str, str]:
    """Return the outputs of the job plan, one line each.

    The cells are an object by their names. A matrix has the names alone: GitHub shows all values of a matrix behind the
    name of a job.

    Raises:
        InputError: they are too large.
    """
    outputs = {
        **{job: "true" if runs else "false" for job, runs in plan.jobs.items()},
        **{f"{job}-names": _compact_json([cell.name for cell in cells]) for job, cells in plan.cells_of_job.items()},
        "cells": _compact_json({cell.name: _matrix_entry(cell) for cell in plan.cells}),
        "collects-in-image": "true" if plan.collects_in_image else "false",
        "push": "true" if plan.push else "false",
        "promote": _compact_json(plan.promote),
        "plan-sha256": hashlib.sha256(plan_text(plan).encode()).hexdigest(),
    }
    size = len(_compact_json(outputs).encode())
    if size > MAX_OUTPUT_BYTES:
        raise InputError(
            f"the plan takes {size} bytes, {MAX_OUTPUT_BYTES} is the limit: set noise-inside-cells: true, or shorten "
            "the names of the systems and datasets"
        )
    return outputs


def plan_text(plan: WorkflowPlan) -> str:
    """Return the whole plan as JSON, for a file: an environment variable takes 128 KiB at most (MAX_ARG_STRLEN)."""
    return _compact_json(asdict(plan))


def plan_of_text(text: str, sha256: str) -> WorkflowPlan:
    """Parse the plan from the text of its file.

    Args:
        text: content of the file, which came by an artifact.
        sha256: hash of the file by an output of the job plan, which no other job can change.

    Raises:
        InputError: it is not the text with this hash.
    """
    if hashlib.sha256(text.encode()).hexdigest() != sha256:
        raise InputError("found another plan than the job plan has made: has another job replaced its artifact?")
    document = json.loads(text)
    cells = tuple(JobCell(**_with_tuples(cell)) for cell in document.pop("cells"))
    return WorkflowPlan(cells=cells, **_with_tuples(document))


def _with_tuples(document: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in document.items()}


def _matrix_entry(cell: JobCell) -> dict[str, str]:
    return {
        "slug": cell.slug,
        "system": cell.system,
        "dataset": cell.dataset,
        "translation-noise": _comma_separated(cell.translations),
        "rotation-noise": _comma_separated(cell.rotations),
        "image": cell.image,
        "collected": "true" if cell.collected else "false",
    }


def _comma_separated(values: Sequence[float]) -> str:
    return ",".join(map(number_text, values))


def _compact_json(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))


PLAN_FILE = "plan.json"
MAX_PLAN_BYTES = 4 * 1024**2
"""Limit of the plan's file: 256 jobs with long paths take half a megabyte."""


def read_plan(folder: Path, sha256: str) -> WorkflowPlan:
    """Read the plan from its artifact.

    Where it is the only artifact its file is in the folder itself: download-artifact makes a folder for each of
    several artifacts, but none for a single one.

    Raises:
        InputError: it is missing, or is not the file with this hash.
    """
    path = folder / PLAN_SLUG / PLAN_FILE
    path = path if path.exists() else folder / PLAN_FILE
    if not path.exists():
        raise InputError(f"{path}: the plan is missing: did the job plan keep its artifact?")
    return plan_of_text(read_bytes(path, MAX_PLAN_BYTES, "a plan").decode(errors="replace"), sha256)


def name_folders_by_slug(folder: Path, artifact_name: str) -> None:
    """Rename the folders of artifacts, NAME~SLUG, to the slugs alone; other files of the folder are not touched.

    Raises:
        InfrastructureError: one cannot be renamed.
    """
    prefix = f"{artifact_name}~"
    for path in sorted(folder.glob(f"{prefix}*")):
        try:
            path.rename(folder / path.name.removeprefix(prefix))
        except OSError as error:
            raise InfrastructureError(f"{path}: cannot be renamed: {error.strerror}") from error
