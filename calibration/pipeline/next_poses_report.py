"""What to record next for the systems of a configuration, and the report on it."""

from collections.abc import Mapping
from dataclasses import replace

from calibration.base import InputError
from calibration.base.records import field, result
from calibration.ci.pages.html import bullets, element, page, section
from calibration.ci.report import Lines, Report, Table, shown
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.tasks.task_errors import task_errors
from calibration.pipeline.matrix.matrix import load
from calibration.pipeline.matrix.next_poses_result import NextPoses
from calibration.pipeline.next_poses import AdvisedPoses, advise
from calibration.pipeline.page.label_residuals import pose_figures
from calibration.pipeline.results import PAGE_FILE
from calibration.pipeline.system import System

TITLE = "Next poses"


@result
class NextPosesOfSystems:
    """Results of next-pose and plan-recording."""

    systems: Mapping[str, NextPoses] = field("What to record next, by system.")


def advise_system(system: System, count: int, seed: int) -> AdvisedPoses:
    """Calibrate a configured system, and return what to record next for its limits.

    Raises:
        InputError: its dataset is collected in a run only, or cannot be calibrated.
    """
    if system.collected is not None:
        raise InputError(f"{system.name}: its dataset is collected in each run: give the folder of a recording")
    loaded = load(system)
    calibration = loaded.prepared.optimum
    if not calibration.converged:
        raise InputError(f"{loaded.dataset.path}: no advice: it does not calibrate: {calibration.reason}")
    tasks = task_errors(calibration, loaded.tasks)
    advised = advise(calibration, loaded, tasks, count, seed)
    found = diagnose(calibration, loaded.dataset, loaded.options, loaded.limits, loaded.truth is not None, tasks)
    wrong = tuple(f"mend first: {each.text}" for each in found if each.severity == "red" and each.kind != "precision")
    return replace(advised, found=replace(advised.found, remarks=(*wrong, *advised.found.remarks)))


def next_poses_report(advised: Mapping[str, AdvisedPoses]) -> Report:
    """Return the report of poses to take next, by system."""
    alone = len(advised) == 1
    files = {
        name if alone else f"{system}-{name}": text_
        for system, each in advised.items()
        for name, text_ in each.files.items()
    }
    sections = [
        section(system, bullets(each.found.lines), pose_figures(each, each.recording))
        for system, each in advised.items()
    ]
    goals = Table(
        ("System", "Limit of", "Limit", "Decided at", "Now", "At best"),
        tuple(
            (
                system,
                goal.name,
                *(shown(v, ".3g", goal.unit) for v in (goal.limit, goal.wanted, goal.now, goal.least)),
            )
            for system, each in advised.items()
            for goal in each.found.goals
        ),
    )
    lines = tuple(line if alone else f"{name}: {line}" for name, each in advised.items() for line in each.found.lines)
    return Report(
        title=TITLE,
        verdict="pass",
        judges=False,
        sentence="; ".join(
            each.found.sentence if alone else f"{name}: {each.found.sentence}" for name, each in advised.items()
        ),
        results=NextPosesOfSystems({name: each.found for name, each in advised.items()}),
        suites={},
        outputs={},
        blocks=(goals, Lines(lines, title="What to record")),
        files={**files, PAGE_FILE: page(TITLE, [element("h1", TITLE), *sections])},
    )
