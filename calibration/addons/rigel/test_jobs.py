"""Section ``requirements`` of calibration.yml, from jobs that test by HPL over ROS messages."""

from collections.abc import Sequence
from typing import Any

from calibration.addons.rigel.document import RigelJob
from calibration.addons.rigel.fields import Fields, Notes, list_at
from calibration.ci.execution.backends import SECTIONS

TEST_PLUGIN = "TestPlugin"
SECTION = "requirements"
NO_BAG = "TODO.bag"
"""Placeholder for the bag."""


def requirements_section(jobs: Sequence[RigelJob], notes: Notes) -> tuple[dict[str, Any], list[str]]:
    """Return the section, and the names of the jobs that it is made of; empty without any.

    Raises:
        InputError: a field has the wrong type.
    """
    properties: dict[str, None] = {}
    origins = []
    for job in jobs:
        found = _properties_of_job(job, notes)
        if found and SECTION not in SECTIONS:
            notes.lost(job.where.removesuffix(".with"), "requirements on ROS messages are not checked here")
        elif found:
            properties |= dict.fromkeys(found)
            origins.append(job.name)
    if not properties:
        return {}, []
    notes.to_do(f"{SECTION}.bag", "name the bag with the robot's messages: a file of ROS 1, or a folder of ROS 2")
    return {"bag": NO_BAG, "hpl": list(properties)}, origins


def is_test_of_messages(job: RigelJob) -> bool:
    """Return whether a job judges messages, and runs no containers, as it does in older Rigelfiles."""
    return job.kind == TEST_PLUGIN and "components" not in job.fields


def _properties_of_job(job: RigelJob, notes: Notes) -> list[str]:
    if is_test_of_messages(job):
        fields = Fields(job.fields, job.where, notes)
        found = fields.plains("requirements")
        _note_differences(fields, notes)
        if not found:
            notes.lost(job.where.removesuffix(".with"), "it has no requirements")
    else:
        where = f"{job.where}.components"
        components = list_at(job.fields.get("components"), where)
        judged = [each["introspection"] for each in components if isinstance(each, dict) and "introspection" in each]
        found = [
            text
            for each in judged
            if isinstance(each, dict)
            for text in Fields(each, f"{where}.introspection", notes).plains("requirements")
        ]
    return [" ".join(text.split()) for text in found]


def _note_differences(fields: Fields, notes: Notes) -> None:
    for key in ("hostname", "port"):
        if fields.take(key) is not None:
            notes.lost(fields.at(key), "nothing is connected to: a bag is judged")
    if fields.take("timeout") is not None:
        notes.changed(fields.at("timeout"), "a bag is judged to its end: record for so long")
    if fields.take("ignore"):
        notes.lost(fields.at("ignore"), "every message of a bag counts: begin to record later")
    notes.changed(fields.where, "a requirement that is not met makes the verdict fail, where Rigel only prints it")
    fields.rest()
