"""Stage judge: requirements over messages, judged over a bag."""

from pathlib import Path

from calibration.addons.requirements.check_messages import judged
from calibration.addons.requirements.results import JudgedMessages, MessageResults, annotations_of
from calibration.addons.requirements.settings import RequirementSettings
from calibration.base.errors import InputError
from calibration.ci.execution.ros import MESSAGES_FOLDER
from calibration.ci.report import FILES, remove_results
from calibration.ci.workflow import annotate
from calibration.pipeline.stages.running import COLLECTED_FOLDER, PipelineRun

STAGE_FOLDER = "requirements"


def judge_stage(run: PipelineRun) -> PipelineRun:
    """Judge the requirements; one that is not met is a reason of the verdict.

    Raises:
        InputError: a requirement or the bag is wrong.
        InfrastructureError: a library is not installed, or a file cannot be written.
    """
    settings: RequirementSettings = run.sections.of("requirements")
    folder = run.output / STAGE_FOLDER
    remove_results(folder, FILES)
    bags = settings.bags if settings.recorded_by is None else _recorded_bag(run, settings.recorded_by)
    report = judged(settings, bags, run.config or Path("calibration.yml"))
    report.write(folder)
    annotate(run.runner, annotations_of(report))
    results: MessageResults = report.results
    result = JudgedMessages(
        requirements=len(results.requirements),
        not_met=results.not_met,
        vacuous=results.warnings,
        folder=STAGE_FOLDER,
        reasons=tuple(f"requirements: {reason}" for reason in results.reasons),
    )
    return run.with_result("requirements", result)


def _recorded_bag(run: PipelineRun, name: str) -> list[Path]:
    """Return the files of the bag that an entry of ``simulation`` has recorded, in this run or an earlier one.

    Raises:
        InputError: there is none.
    """
    folder = run.output / COLLECTED_FOLDER / name / MESSAGES_FOLDER
    found = sorted([*folder.glob("*.bag"), *(file.parent for file in folder.glob("*/metadata.yaml"))])
    if not found and (open_bags := [file.name for file in folder.glob("*.active")]):
        raise InputError(f"{folder}: found {open_bags[0]}: the recorder was killed before it had closed the bag")
    if not found:
        raise InputError(
            f"{run.config}: requirements.bag: found no bag in {folder}, expected one that simulation.{name} records: "
            "add 'record: {}' to it, and run the stage collect"
        )
    return found
