"""Builds on the real engine: specifications of a test, and images that are removed after it."""

import io
import uuid
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from calibration.ci.github.service import GITHUB
from calibration.ci.image.building import BuiltImage, build_image
from calibration.ci.image.specification import parse_image_specification
from calibration.ci.workflow import Runner

if TYPE_CHECKING:
    from docker import DockerClient


@dataclass
class Builds:
    """Folder for the files of a test, and name for its images."""

    engine: "DockerClient"
    folder: Path
    name: str
    runner: Runner = field(default_factory=lambda: Runner(GITHUB, stdout=io.StringIO(), stderr=io.StringIO()))

    def write(self, path: str, content: str, mode: int = 0o644) -> Path:
        file = self.folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content)
        file.chmod(mode)
        return file

    def build(self, options: dict[str, Any] | None = None, **entry: Any) -> BuiltImage:
        """Build an entry of a specification (its keys with ``_`` for ``-``)."""
        document = {key.replace("_", "-"): value for key, value in {"name": self.name, **entry}.items()}
        return build_image(parse_image_specification(document, self.folder, "test"), self.runner, **(options or {}))

    def run(self, image: str, *command: str, **options: Any) -> str:
        """Run a container of an image, and return its output."""
        return str(self.engine.containers.run(image, list(command) or None, remove=True, **options).decode()).strip()

    @property
    def log(self) -> str:
        assert isinstance(self.runner.stdout, io.StringIO)
        return self.runner.stdout.getvalue()

    def forget(self) -> None:
        """Remove all images of this test from the engine."""
        for kind, sign in (("RepoTags", ":"), ("RepoDigests", "@")):  # removing the last tag removes the digest
            for name in self._names(kind, sign):
                self.engine.images.remove(name, force=True)

    def tags(self) -> list[str]:
        """Return the names of this test's images on the engine."""
        return self._names("RepoTags", ":")

    def _names(self, kind: str, sign: str) -> list[str]:
        # Not images.list(): it inspects each image, and those of other tests may be removed meanwhile.
        names = [name for image in self.engine.api.images() for name in image[kind] or ()]
        return [name for name in names if name.rpartition(sign)[0].endswith(self.name.rpartition("/")[2])]


@pytest.fixture
def builds(engine: "DockerClient", base_image: str, tmp_path: Path) -> Iterator[Builds]:
    assert base_image
    builds = Builds(engine, tmp_path, f"calibration-test-{uuid.uuid4().hex[:12]}")
    yield builds
    builds.forget()
