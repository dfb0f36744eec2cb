"""Tests of the team's software in its image: run in containers, judged by the reports that they leave.

Nothing of the image is trusted: containers have the limits of jobs, and their reports are read within bounds.

- ``settings``: an entry of the section ``tests``, and its job;
- ``run_tests.sh``: what the container runs: finds the tool of the workspace, and collects reports and coverage;
- ``results``: the files and the end of a run, as its verdict; what was found, and its report;
- ``test_image``: all entries, with their repeats and retries; the command, and the stage.
"""

from calibration.base.addons import Addon, AddonStage, DocumentSection, LazyCommand, SchemaFile

ADDON = Addon(
    commands={
        "test-image": LazyCommand(f"{__name__}.test_image:command", "Run the tests of the software in its image.")
    },
    sections={
        "tests": DocumentSection(
            f"{__name__}.settings:TESTS_BY_NAME", "Tests of the software in its image, by name: a stage of run."
        )
    },
    stages={
        "test": AddonStage(
            f"{__name__}.test_image:test_stage",
            section="tests",
            result=DocumentSection(f"{__name__}.results:Tested", "Tests in the image, where calibration.yml has any."),
            needs_image=True,
            job="test-image",
        )
    },
    schemas={"tests": SchemaFile(__name__, "results.schema.json", "results:ImageTestsResults", "test-image")},
)
