"""Builds for several platforms, with a program that replaces docker's buildx and records its arguments.

buildx is missing without Docker's own packages; the test checks the arguments, not the build.
"""

import io
import json
import tarfile
from pathlib import Path

import pytest

from calibration.base import InfrastructureError
from calibration.ci.github.service import GITHUB
from calibration.ci.image.build_request import BuildFailedError, BuildLog, BuildRequest, SecretValue
from calibration.ci.image.builders import Program, build_and_push, build_by_buildkit
from calibration.ci.image.context import Context
from calibration.ci.registries.reference import Credentials
from calibration.ci.workflow import Runner

DIGEST = f"sha256:{'d' * 64}"
SCRIPT = """#!/bin/sh
{ printf '<%s>' "$@"; echo; } >> "$CALLS/calls"
[ "$2" = build ] || exit ${ADMINISTER:-0}
cat > "$CALLS/context.tar"
cp "$DOCKER_CONFIG/config.json" "$CALLS/" 2>/dev/null
for word; do
    case "$previous" in
        --metadata-file) echo "$METADATA" > "$word";;
        --secret) cat "${word#*src=}" > "$CALLS/secret"; stat -c %a "${word#*src=}" >> "$CALLS/secret";;
    esac
    previous=$word
done
[ -z "$FAIL" ] || { echo "#3 [2/2] RUN x"; echo '#3 ERROR: process "x" did not complete: exit code: 9'; exit 1; }
echo "#1 [1/1] FROM x"
"""


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Program:
    path = tmp_path / "docker"
    path.write_text(SCRIPT)
    path.chmod(0o755)
    for name, value in {"CALLS": str(tmp_path), "DOCKER_CONFIG": str(tmp_path / "none")}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("METADATA", json.dumps({"containerimage.digest": DIGEST}))
    return Program(str(path), buildx=True)


@pytest.fixture
def log() -> BuildLog:
    return BuildLog(Runner(GITHUB, stdout=io.StringIO()), lambda *_, **__: None)


def request(**other: object) -> BuildRequest:
    context = Context()
    context.add_bytes("Dockerfile", b"FROM x")
    return BuildRequest(name="robot", context=context, dockerfile="Dockerfile", **other)  # type: ignore[arg-type]


def calls(folder: Path) -> list[list[str]]:
    return [line[1:-1].split("><") for line in (folder / "calls").read_text().splitlines()]


def test_built_and_pushed_by_a_builder_of_our_own(program: Program, log: BuildLog, tmp_path: Path) -> None:
    asked = request(
        platforms=("linux/amd64", "linux/arm64"),
        labels={"a": "b c"},
        build_arguments={"A": "1"},
        target="t",
        secrets=[SecretValue("s", b"hunter2")],
        no_cache=True,
    )
    login = Credentials("r", "bot", "hunter3")
    assert build_and_push(program, asked, ["r/robot:key-1"], login, log) == DIGEST
    create, build, remove = calls(tmp_path)
    name = create[create.index("--name") + 1]
    assert create == ["buildx", "create", "--name", name, "--driver", "docker-container"]
    assert remove == ["buildx", "rm", "--force", name]
    assert build[:5] == ["buildx", "build", "--builder", name, "--push"]
    text = " ".join(build)
    for part in (
        "--tag r/robot:key-1",
        "--platform linux/amd64,linux/arm64",
        "--label a=b c",
        "--build-arg A=1",
        "--target t",
        "--no-cache",
        "--secret id=s,src=",
    ):
        assert part in text
    assert build[-1] == "-"
    assert "hunter" not in (tmp_path / "calls").read_text()
    assert (tmp_path / "secret").read_text() == "hunter2600\n"
    assert "r" in json.loads((tmp_path / "config.json").read_text())["auths"]
    with tarfile.open(tmp_path / "context.tar") as archive:
        assert archive.getnames() == ["Dockerfile"]


@pytest.mark.parametrize("attest", [True, False])
def test_attestations_are_made_where_they_are_asked_for(
    program: Program, log: BuildLog, tmp_path: Path, attest: bool
) -> None:
    assert build_and_push(program, request(attest=attest), ["r/robot:key-1"], Credentials("r"), log) == DIGEST
    _, build, _ = calls(tmp_path)
    assert ({"--sbom=true", "--provenance=mode=max"} <= set(build)) is attest


@pytest.mark.parametrize("variable", ["FAIL", "METADATA", "ADMINISTER"])
def test_the_builder_is_removed_whatever_happens(
    program: Program, log: BuildLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    monkeypatch.setenv(variable, "1")
    error = BuildFailedError if variable == "FAIL" else InfrastructureError
    with pytest.raises(
        error, match=r"step 2 of 2, RUN x: exit code 9|ended without a digest|docker buildx (create|rm)"
    ):
        build_and_push(program, request(), ["r/robot:key-1"], Credentials("r"), log)
    assert calls(tmp_path)[-1][:2] == ["buildx", "rm"]


def test_buildx_for_one_platform_loads(program: Program, log: BuildLog, tmp_path: Path) -> None:
    build_by_buildkit(program, request(), "robot:key-1", log)
    [build] = calls(tmp_path)
    assert build[:7] == ["buildx", "build", "--builder", "default", "--load", "--tag", "robot:key-1"]


def test_a_program_that_is_gone(log: BuildLog) -> None:
    with pytest.raises(InfrastructureError, match="docker buildx rm"):
        build_and_push(Program("/nowhere/docker", buildx=True), request(), [], Credentials("r"), log)
