"""The stage promote, where it leaves the registry alone."""

from dataclasses import replace
from pathlib import Path

import pytest

from calibration.base import InfrastructureError
from calibration.ci.image.specification import ImageSpecification, OwnDockerfile
from calibration.ci.workflow import Runner
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.results import Collected, ImageResult, PipelineResults
from calibration.pipeline.running import PipelineRun
from calibration.pipeline.stages import promote_stage
from calibration.pipeline.system import NoiseGrid

SPECIFICATION = ImageSpecification(
    OwnDockerfile(Path("Dockerfile"), Path()), name="127.0.0.1:9/team/robot", promote=("stable",)
)  # where nobody answers
IMAGE = ImageResult("127.0.0.1:9/team/robot:key-1", "1", built=True, digest="sha256:" + "0" * 64, seconds=1.0)
PASSED = PipelineResults((), (), (Collected("fresh"),), IMAGE)


def asked(results: PipelineResults, output: Path, pull_request: bool = False) -> PipelineRun:
    runner = Runner(pull_request=pull_request)
    return PipelineRun(Matrix((), NoiseGrid()), output, runner, image=SPECIFICATION, results=results)


def test_a_pull_request_promotes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert PASSED.verdict == "pass"
    assert promote_stage(asked(PASSED, tmp_path, pull_request=True)).results is PASSED
    assert capsys.readouterr().out == "not promoted: a pull request is not merged yet\n"


def test_an_image_that_was_not_pushed_cannot_be_promoted(tmp_path: Path) -> None:
    results = replace(PASSED, image=replace(IMAGE, digest=None))
    with pytest.raises(
        InfrastructureError, match=r"^image\.promote: .* is in no registry; add push: true to the section image$"
    ):
        promote_stage(asked(results, tmp_path))


def test_anything_else_asks_the_registry(tmp_path: Path) -> None:
    with pytest.raises(InfrastructureError, match=r"127\.0\.0\.1:9"):
        promote_stage(asked(PASSED, tmp_path))
