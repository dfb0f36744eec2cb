"""The command without an engine: reading, validation, rendering and report."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from calibration.__main__ import main, run_action
from calibration.ci.image import building
from calibration.ci.image.build_request import BuildFailedError
from calibration.ci.image.building import BuiltImage
from calibration.ci.image.specification import ImageSpecification, OwnDockerfile
from calibration.ci.registries.reference import Credentials
from calibration.ci.workflow import Runner
from calibration.commands import build_image

SCHEMA = json.loads(Path(building.__file__).with_name("results.schema.json").read_text())
DIGEST = f"sha256:{'a' * 64}"
IMAGE = BuiltImage(
    "ghcr.io/t/r:key-1", "1" * 64, built=True, id="sha256:i", digest=DIGEST, tags=("ghcr.io/t/r:edge",), seconds=1.5
)


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    import os

    for name in [name for name in os.environ if name.startswith(("GITHUB_", "INPUT_", "CALIBRATION_REGISTRY"))]:
        monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "calibration.yml").write_text("systems: {}\nimage: {name: ghcr.io/t/r, base: debian, tags: [edge]}")
    return tmp_path


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[ImageSpecification, dict[str, Any]]]:
    """Record the requests to build and to promote an image."""
    calls: list[Any] = []

    def build(specification: ImageSpecification, _runner: Runner, **options: Any) -> BuiltImage:
        calls.append((specification, options))
        return IMAGE

    def promote(name: str, digest: str, tags: tuple[str, ...], credentials: Credentials, _runner: Runner) -> list[str]:
        calls.append((name, digest, tags, credentials.username))
        return [f"{name}:{tag}" for tag in tags]

    def log_in(settings: Any, name: str, _runner: Runner) -> Credentials:
        return Credentials("ghcr.io", settings.username if settings else "")

    monkeypatch.setattr(build_image, "build_image", build)
    monkeypatch.setattr(build_image, "promote", promote)
    monkeypatch.setattr(build_image, "registry_login", log_in)
    return calls


def results(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "results.json").read_text())
    jsonschema.validate(document, SCHEMA)
    return document


def test_the_image_of_calibration_yml(asked: list[Any], here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["build-image", "--output", "out"]) == 0
    [(specification, options)] = asked
    assert (specification.name, specification.tags, specification.push) == ("ghcr.io/t/r", ("edge",), False)
    assert options == {
        "push": False,
        "load": True,
        "builder": "auto",
        "force": False,
        "pull": False,
        "leave_out": (Path("out"),),
    }
    found = results(here / "out")
    assert (found["verdict"], found["reference"], found["built"]) == ("pass", IMAGE.reference, True)
    assert (found["digest"], found["id"], found["key"]) == (DIGEST, "sha256:i", "1" * 64)
    assert capsys.readouterr().out.startswith("pass: ghcr.io/t/r:key-1: built (")
    assert "ghcr.io/t/r:edge" in (here / "out" / "summary.md").read_text()


def test_options_win_over_the_file(asked: list[Any]) -> None:
    arguments = "--name 127.0.0.1:5/x --tags a,b --push --load no --builder engine --force --pull"
    assert main(["build-image", *arguments.split()]) == 0
    [(specification, options)] = asked
    assert (specification.name, specification.tags) == ("127.0.0.1:5/x", ("a", "b"))
    assert (options["push"], options["load"], options["builder"]) == (True, False, "engine")
    assert (options["force"], options["pull"]) == (True, True)


def test_a_pushed_image_need_not_be_here(asked: list[Any]) -> None:
    assert main(["build-image", "--push"]) == 0
    assert asked[0][1]["load"] is False


def test_a_dockerfile(asked: list[Any], here: Path) -> None:
    assert main(["build-image", "--dockerfile", "docker/Dockerfile", "--context", "src"]) == 0
    source = asked[0][0].source
    assert source == OwnDockerfile(Path("docker/Dockerfile"), Path("src"))


def test_promote_after_the_build_pushes(asked: list[Any], here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["build-image", "--promote", "stable,1.0", "--output", "out"]) == 0
    assert asked[0][1]["push"] is True
    assert asked[1] == ("ghcr.io/t/r", DIGEST, ("stable", "1.0"), "")
    assert results(here / "out")["promoted"] == ["ghcr.io/t/r:stable", "ghcr.io/t/r:1.0"]
    assert "built, promoted to ghcr.io/t/r:stable, ghcr.io/t/r:1.0 (" in capsys.readouterr().out


def test_promote_a_digest_builds_nothing(asked: list[Any], here: Path) -> None:
    (here / "calibration.yml").unlink()
    arguments = ["--name", "ghcr.io/t/x", "--digest", DIGEST, "--promote", "stable", "--output", "out"]
    assert main(["build-image", *arguments]) == 0
    assert asked == [("ghcr.io/t/x", DIGEST, ("stable",), "")]
    found = results(here / "out")
    assert (found["reference"], found["digest"], found["built"]) == (f"ghcr.io/t/x@{DIGEST}", DIGEST, False)
    assert "is promoted to ghcr.io/t/x:stable" in (here / "out" / "summary.md").read_text()


def test_as_an_action(asked: list[Any], here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outputs = here / "outputs"
    variables = {"GITHUB_ACTIONS": "true", "GITHUB_OUTPUT": str(outputs), "INPUT_PROMOTE": "edge,stable"}
    variables |= {"INPUT_REGISTRY_USERNAME": "bot", "INPUT_REGISTRY_PASSWORD": "hunter2", "INPUT_OUTPUT": "out"}
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert run_action("build-image") == 0
    assert asked[0][0].registry.username == "bot"
    assert asked[0][0].registry.password_variable == "INPUT_REGISTRY_PASSWORD"  # noqa: S105
    assert asked[1][3] == "bot"
    assert outputs.read_text().splitlines() == [
        "verdict=pass",
        "results=out/results.json",
        "summary=out/summary.md",
        "reference=ghcr.io/t/r:key-1",
        f"digest={DIGEST}",
        f"key={'1' * 64}",
        "image-id=sha256:i",
        "built=true",
        'tags=["ghcr.io/t/r:edge", "ghcr.io/t/r:stable"]',
    ]


def test_the_password_is_masked_first(
    asked: list[Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("INPUT_REGISTRY_PASSWORD", "hunter2")
    assert run_action("build-image") == 2
    out = capsys.readouterr().out
    assert out.startswith("::add-mask::hunter2\n")
    assert "registry-username is not given" in out


def test_a_password_on_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["build-image", "--registry-username", "bot", "--registry-password", "hunter2"]) == 2
    out, err = capsys.readouterr()
    assert "put it into the environment variable CALIBRATION_REGISTRY_PASSWORD" in err
    assert "hunter2" not in out + err


def test_a_password_by_the_environment(asked: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CALIBRATION_REGISTRY_PASSWORD", "hunter2")
    assert main(["build-image", "--registry-username", "bot"]) == 0
    registry = asked[0][0].registry
    assert (registry.username, registry.password_variable) == ("bot", "CALIBRATION_REGISTRY_PASSWORD")
    assert "hunter2" not in repr(asked)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--spec a --dockerfile b", "spec and dockerfile are both given"),
        ("--context a", "context is given without the dockerfile"),
        ("--spec nothing.yml", "nothing.yml: an image specification was expected, but it cannot be read"),
        ("--builder kaniko", "'kaniko' is not one of 'auto', 'engine', 'buildkit'"),
        (f"--digest {DIGEST}", "digest is given without promote"),
        ("--name a:b", "a name without a tag was expected"),
        ("--tags a:b", "found the tag 'a:b'"),
        ("--registry-username bot", "registry-password is not given"),
        ("--render x --dockerfile Dockerfile", "render: your own Dockerfile exists already"),
    ],
)
def test_errors(arguments: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["build-image", *arguments.split()]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.splitlines()) == 1


def test_a_failing_step_is_one_annotation(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise BuildFailedError("r", "step 2 of 3, RUN make", "exit code 2", ["one", "::warning::two"])

    monkeypatch.setattr(build_image, "build_image", fail)
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    assert main(["build-image", "--output", "out"]) == 1
    out, err = capsys.readouterr()
    annotations = [line for line in out.splitlines() if line.startswith(("::error", "::warning"))]
    headline = "image r: step 2 of 3, RUN make: exit code 2"
    assert annotations == [f"::error file=calibration.yml,title=Image::{headline}%0Aone%0A::warning::two"]
    assert err == ""
    found = results(here / "out")
    assert (found["verdict"], found["failure"]) == ("fail", {"message": headline, "lines": ["one", "::warning::two"]})
    assert "```\none\n::warning::two\n```" in (here / "out" / "summary.md").read_text()


def test_a_failing_step_off_github(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise BuildFailedError("r", "", "unknown instruction: FORM")

    monkeypatch.setattr(build_image, "build_image", fail)
    assert main(["build-image"]) == 1
    out, err = capsys.readouterr()
    assert err == "error: calibration.yml: image r: unknown instruction: FORM\n"
    assert out == "fail: image r: unknown instruction: FORM\n"


def test_no_earlier_result_is_mistaken_for_this_ones(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "out").mkdir()
    (here / "out" / "results.json").write_text("{}")
    assert main(["build-image", "--spec", "nothing", "--output", "out"]) == 2
    assert not (here / "out" / "results.json").exists()
    (here / "out" / "results.json").mkdir()
    assert main(["build-image", "--output", "out"]) == 3
    assert "an earlier result cannot be removed" in capsys.readouterr().err


def test_render_writes_a_complete_context(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "robot").mkdir()
    (here / "robot" / "run.py").write_text("x")
    spec = "{base: debian, files: [{from: robot, to: /opt}], entrypoint: [export A=1]}"
    (here / "image.yml").write_text(spec)
    assert main(["build-image", "--spec", "image.yml", "--render", "new"]) == 0
    assert 'COPY ["files/0/", "/opt/"]' in (here / "new" / "Dockerfile").read_text()
    assert (here / "new" / "entrypoint.sh").stat().st_mode & 0o777 == 0o755
    assert (here / "new" / "files" / "0" / "run.py").read_text() == "x"
    assert "pass: new has the Dockerfile and all that it copies" in capsys.readouterr().out
    assert main(["build-image", "--spec", "image.yml", "--render", "new"]) == 2


def test_the_specification_is_not_read_as_a_pipeline(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "calibration.yml").write_text("systems: {}")
    assert main(["build-image"]) == 2
    assert "calibration.yml: found no key 'image'" in capsys.readouterr().err
