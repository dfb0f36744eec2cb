"""Stage analyse: static analysis of the repository around the configuration."""

from pathlib import Path

from calibration.addons.analysis.results import Analysed
from calibration.addons.analysis.settings import AnalysisSettings
from calibration.addons.analysis.static_analysis import analysed
from calibration.ci.workflow import annotate
from calibration.pipeline.stages.running import PipelineRun

STAGE_FOLDER = "static-analysis"


def analyse_stage(run: PipelineRun) -> PipelineRun:
    """Analyse the repository; a limit that is exceeded is a reason of the verdict.

    Raises:
        InputError: a setting is wrong, or there is nothing to analyse.
        InfrastructureError: an analyser is missing, fails or takes too long, or a file cannot be written.
    """
    settings: AnalysisSettings = run.sections.of("analysis")
    folder = run.output / STAGE_FOLDER
    report, found = analysed(settings, run.config.parent if run.config else Path(), folder, run.runner)
    report.write(folder)
    annotate(run.runner, report.annotations)
    result = Analysed(
        findings=len(found.findings),
        new=None if found.base is None else len(found.new),
        folder=STAGE_FOLDER,
        reasons=tuple(f"static analysis: {reason}" for reason in report.reasons),
    )
    return run.with_result("analysis", result)
