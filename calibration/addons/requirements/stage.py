"""Stage judge: requirements over messages, judged over a bag."""

from pathlib import Path

from calibration.addons.requirements.check_messages import judged
from calibration.addons.requirements.report import annotations_of
from calibration.addons.requirements.results import JudgedMessages, MessageResults
from calibration.addons.requirements.settings import RequirementSettings
from calibration.ci.report import FILES, remove_results
from calibration.ci.workflow import annotate
from calibration.pipeline.stages.running import PipelineRun

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
    report = judged(settings, settings.bags, run.config or Path("calibration.yml"))
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
