"""Plan as outputs of a workflow job, and back."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from calibration.errors import InputError
from calibration.introspection.numbers import number_text, parse_number
from calibration.pipeline.distribution.plan import JobCell, Plan

MOST_BYTES = 112 * 1024
"""Limit of all outputs: the last job gets them in one environment variable, of which Linux allows 128 KiB."""


def plan_outputs(plan: Plan) -> dict[str, str]:
    """Return the outputs of the job plan, one line each.

    Raises:
        InputError: they are too large.
    """
    outputs = {
        **{job: "true" if runs else "false" for job, runs in plan.jobs.items()},
        "cells": _json([_entry(cell) for cell in plan.at_once]),
        "collected-cells": _json([_entry(cell) for cell in plan.after_collection]),
        "simulations": _json(plan.simulations),
        "seeds": _json(len(plan.seeds) if plan.seeds == tuple(range(1, len(plan.seeds) + 1)) else plan.seeds),
        "collects-in-image": "true" if plan.collects_in_image else "false",
        "push": "true" if plan.push else "false",
        "promote": _json(plan.promote),
        "minute-rate": _json(plan.minute_rate),
    }
    size = len(_json(outputs).encode())
    if size > MOST_BYTES:
        raise InputError(
            f"the plan takes {size} bytes, {MOST_BYTES} is the limit: set noise-inside-cells: true, or shorten the "
            "names of the systems and datasets, or the list of seeds"
        )
    return outputs


def plan_of_outputs(outputs: Mapping[str, Any]) -> Plan:
    """Parse the plan from these outputs.

    Raises:
        InputError: they are not those of a plan.
    """
    try:
        seeds = json.loads(outputs["seeds"])
        plan = Plan(
            cells=tuple(_cell(entry) for key in ("cells", "collected-cells") for entry in json.loads(outputs[key])),
            seeds=tuple(range(1, seeds + 1)) if isinstance(seeds, int) else tuple(seeds),
            simulations=tuple(json.loads(outputs["simulations"])),
            unit_tests=outputs["unit-tests"] == "true",
            image=outputs["image"] == "true",
            collects_in_image=outputs["collects-in-image"] == "true",
            push=outputs["push"] == "true",
            promote=tuple(json.loads(outputs["promote"])),
            minute_rate=parse_number(outputs["minute-rate"]),
            static_analysis=outputs["static-analysis"] == "true",
        )
        if plan_outputs(plan) == dict(outputs):
            return plan
    except (KeyError, TypeError, ValueError, AttributeError):
        pass
    raise InputError(
        "the outputs of the job plan are not those of plan-matrix; GitHub drops an output that contains the value of a "
        "secret: is a secret as short as a number or a system's name?"
    )


def _entry(cell: JobCell) -> dict[str, str]:
    return {
        "name": cell.name,
        "slug": cell.slug,
        "system": cell.system,
        "dataset": cell.dataset,
        "translation-noise": _numbers(cell.translations),
        "rotation-noise": _numbers(cell.rotations),
        "image": cell.image,
        "collected": "true" if cell.collected else "false",
    }


def _cell(entry: Mapping[str, Any]) -> JobCell:
    return JobCell(
        entry["name"],
        entry["slug"],
        entry["system"],
        tuple(map(float, entry["translation-noise"].split(","))),
        tuple(map(float, entry["rotation-noise"].split(","))),
        dataset=entry["dataset"],
        image=entry["image"],
        collected=entry["collected"] == "true",
    )


def _numbers(values: Sequence[float]) -> str:
    return ",".join(map(number_text, values))


def _json(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))
