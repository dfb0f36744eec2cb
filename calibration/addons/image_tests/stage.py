"""Stage test: the tests of the software in the image of the run."""

from pathlib import Path

from calibration.addons.image_tests.results import Tested
from calibration.addons.image_tests.running import check_tests, run_image_tests
from calibration.addons.image_tests.settings import ImageTests
from calibration.ci.image.specification import Recipe
from calibration.ci.workflow import annotate
from calibration.pipeline.stages.running import PipelineRun

STAGE_FOLDER = "tests"


def test_stage(run: PipelineRun) -> PipelineRun:
    """Run the tests; one that fails is a reason of the verdict.

    Raises:
        InputError: a job is invalid, a secret is not set, or an image is missing.
        InfrastructureError: there is no engine, or a file cannot be written.
    """
    entries: tuple[ImageTests, ...] = run.sections.of("tests")
    check_tests(entries, run.image is not None)
    image = run.results.image.reference if run.results.image else ""
    source = run.image.source if run.image else None
    workspace = source.workspace.path if isinstance(source, Recipe) and source.workspace else None
    folder = run.output / STAGE_FOLDER
    repository = run.config.parent if run.config else Path()
    tests = [each.with_defaults(image, workspace) for each in entries]
    report, found = run_image_tests(tests, folder, repository, run.target, run.runner)
    report.write(folder)
    annotate(run.runner, report.annotations)
    runs = [each for entry in found.tests for each in entry.runs]
    result = Tested(
        passed=sum(each.passed for each in runs),
        failed=sum(each.failed for each in runs),
        folder=STAGE_FOLDER,
        reasons=tuple(f"tests: {reason}" for reason in found.reasons),
    )
    return run.with_result("tests", result)


test_stage.__test__ = False  # type: ignore[attr-defined] # keeps pytest from collecting it
