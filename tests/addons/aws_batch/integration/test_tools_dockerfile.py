"""The Dockerfile of examples/aws-batch, built, and a job in a task that it serves."""

import shutil
import subprocess
import sys
import uuid
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calibration.base import ExitCode
from calibration.ci.execution.job import OUTPUT, Artifact
from tests.addons.aws_batch import client
from tests.addons.aws_batch.fixtures import Aws

if TYPE_CHECKING:
    from docker import DockerClient

ROOT = Path(__file__).parents[4]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    [found] = folder.iterdir()
    return found


@pytest.fixture
def image(engine: "DockerClient", python_image: str, wheel: Path, tmp_path: Path) -> Iterator[str]:
    """The image, made as its README says, from the wheel of this checkout."""
    name = f"calibration-test-dockerfile:{uuid.uuid4().hex[:12]}"
    shutil.copy(ROOT / "examples" / "aws-batch" / "Dockerfile", tmp_path)
    shutil.copy(wheel, tmp_path)
    arguments = {"BASE": python_image, "SOURCE": f"file:///context/{wheel.name}"}
    built, _ = engine.images.build(path=str(tmp_path), tag=name, buildargs=arguments, rm=True, forcerm=True)
    yield name
    engine.images.remove(str(built.id), force=True)


@pytest.mark.thorough
def test_a_task_with_this_image(image: str, batch_in_containers: Aws, python_image: str, tmp_path: Path) -> None:
    wanted = client.container(
        image=python_image, command=("touch", f"{OUTPUT}/it"), artifacts=(Artifact(f"{OUTPUT}/it"),)
    )
    settings = replace(client.SETTINGS, tools_image=image)
    [outcome], _ = client.run_jobs(tmp_path / "out", client.job("one", wanted), settings=settings)
    assert (outcome.exit_code, outcome.reasons) == (ExitCode.PASS, ())
    assert [file.path for file in outcome.artifacts] == ["it"]
