"""The reusable workflow with jobs in a plain image: Debian with Python, git and curl, and nothing of GitHub's."""

import io
import os
import re
import secrets
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.engine import Registry

from .conftest import PROJECT, Repository, tool
from .pipeline import Caller

if TYPE_CHECKING:
    from docker import DockerClient

DOCKERFILE = """FROM {base}
USER root
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends git python3-venv && rm -rf /var/lib/apt/lists/*
CMD ["bash"]
"""
EVALUATE = "inter-collection-rgb-to-rgb:rgb_world:rgb_world"


@pytest.fixture(scope="module")
def image(engine: "DockerClient", python_image: str) -> Iterator[str]:
    name = f"calibration-test:runner-{secrets.token_hex(4)}"
    engine.images.build(fileobj=io.BytesIO(DOCKERFILE.format(base=python_image).encode()), tag=name, forcerm=True)
    yield name
    engine.images.remove(name, force=True)


def test_in_a_plain_image(image: str, repository: Repository, tmp_path: Path) -> None:
    caller = Caller(repository, tmp_path / "artifacts")
    caller.write(
        {"runner": '["plain"]', "datasets": "my data/riwbot", "evaluate": EVALUATE},
        {"my data/riwbot": PROJECT / "datasets" / "riwbot"},
    )
    certificates = os.environ.get("SSL_CERT_FILE", "/etc/ssl/certs/ca-certificates.crt")
    shared = {
        str(tmp_path): "",
        str(repository.suite): ":ro",
        certificates: ":ro",
        f"{tool('uv')}:/usr/local/bin/uv": ":ro",
    }
    options = " ".join(f'-v "{path if ":" in path else f"{path}:{path}"}{mode}"' for path, mode in shared.items())
    run = caller.run(
        *("push", "-P", f"plain={image}", "--pull=false", "--container-daemon-socket", "-"),
        *("--container-options", options, "--env", f"SSL_CERT_FILE={certificates}"),
    )
    assert run.code == 0, run.log
    [table] = run.tables
    assert table[1] == ["0 m, 0 rad", "0.1127 px, 0.00227 mm, 0.00026 deg"]  # with what evaluate asks for
    assert run.installations == ["calibrate"] * 3  # in each of the three containers


SOFTWARE = """
image:
  name: "{registry}/pipeline-test"
  base: "{base}"
  files: [{{from: table.csv, to: /opt/table.csv}}]
  push: true
noise: {{translation: [0, 0.5]}}
systems:
  arm:
    dataset: data/riwbot
    software: {{command: [cp, /opt/table.csv, "{{output}}/table.csv"]}}
    rules: [{{column: RMS (pix), row: Averages, max: 1}}]
"""


def test_the_image_is_built_once_and_every_cell_runs_in_it(
    engine: "DockerClient", python_image: str, registry: Registry, repository: Repository, tmp_path: Path
) -> None:
    caller = Caller(repository, tmp_path / "artifacts", {"python": sys.executable})
    table = "Collection #,RMS (pix)\n000,0.5\nAverages,0.5\n"
    caller.write(
        {},
        {
            "data/riwbot": PROJECT / "datasets" / "riwbot",
            "table.csv": table,
            "calibration.yml": SOFTWARE.format(registry=registry.address, base=python_image),
        },
    )
    try:
        run = caller.run()
    finally:
        for image in engine.images.list(f"{registry.address}/pipeline-test"):
            engine.images.remove(image.id, force=True)
    assert run.code == 0, run.log
    built = re.findall(r"set-output:: built=(\w+)", run.log)
    assert built == ["true", "false", "false"]
    [cells] = run.tables
    assert cells[0] == ["Start", "arm: software", "arm: calibration-ci"]
    assert [row[1] for row in cells[1:]] == ["0.5000 px", "0.5000 px"]
