"""Plan as outputs of a workflow job for the jobs that follow, and as a file for the last one."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from calibration.base.errors import InputError
from calibration.base.tables.numbers import number_text
from calibration.pipeline.distribution.plan import JobCell, Plan

MAX_OUTPUT_BYTES = 400 * 1024
"""Limit of all outputs: GitHub takes 1 MB from a job, and counts two bytes for a character."""


def plan_outputs(plan: Plan) -> dict[str, str]:
    """Return the outputs of the job plan, one line each.

    The cells are an object by their names. A matrix has the names alone: GitHub shows all values of a matrix behind the
    name of a job.

    Raises:
        InputError: they are too large.
    """
    outputs = {
        **{job: "true" if runs else "false" for job, runs in plan.jobs.items()},
        **{f"{job}-names": _json([cell.name for cell in cells]) for job, cells in plan.cells_of_job.items()},
        "cells": _json({cell.name: _entry(cell) for cell in plan.cells}),
        "collects-in-image": "true" if plan.collects_in_image else "false",
        "push": "true" if plan.push else "false",
        "promote": _json(plan.promote),
        "plan-sha256": hashlib.sha256(plan_text(plan).encode()).hexdigest(),
    }
    size = len(_json(outputs).encode())
    if size > MAX_OUTPUT_BYTES:
        raise InputError(
            f"the plan takes {size} bytes, {MAX_OUTPUT_BYTES} is the limit: set noise-inside-cells: true, or shorten "
            "the names of the systems and datasets"
        )
    return outputs


def plan_text(plan: Plan) -> str:
    """Return the whole plan as JSON, for a file: an environment variable takes 128 KiB at most (MAX_ARG_STRLEN)."""
    return _json(asdict(plan))


def plan_of_text(text: str, sha256: str) -> Plan:
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
    return Plan(cells=cells, **_with_tuples(document))


def _with_tuples(document: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in document.items()}


def _entry(cell: JobCell) -> dict[str, str]:
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


def _json(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))
