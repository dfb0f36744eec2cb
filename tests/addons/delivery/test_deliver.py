"""``deliver``: versions and changelogs that follow from what changed; faults after which nothing is half delivered."""

import json
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from calibration.__main__ import main
from calibration.addons.delivery.changes import Level, changes_between, level_of, next_version, read_contents
from calibration.addons.delivery.destinations import FetchedBundle
from calibration.addons.delivery.manifest import pack_files, unpack_files
from calibration.base import http
from calibration.engine.baseline.quality import BaselineSettings
from tests.ci.registries.server import Reply, Request
from tests.displaced import displace
from tests.repositories import git

from .bundles import KEY, private_pem, public_pem
from .services import IMAGE, REPOSITORY, Services, services
from .test_bundle import _run_in, calibrated

__all__ = ["calibrated"]
KNOCKED = (0.003, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def moved(calibrated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the repository after a commit with a camera that was moved by 3 mm, which is accepted."""
    folder = tmp_path_factory.mktemp("moved") / "team"
    shutil.copytree(calibrated, folder, symlinks=True)
    displace(folder / "robot", "right_camera", KNOCKED)
    git(folder, "add", ".")
    git(folder, "commit", "-m", "Moved")
    _run_in(folder, "run")
    assert _run_in(folder, "accept", "--systems", "robot") == 0
    git(folder, "add", ".")
    git(folder, "commit", "-m", "Accepted")
    assert _run_in(folder, "run") == 0
    return folder


@pytest.fixture
def there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Services]:
    """Return the services, on a runner of GitHub."""
    monkeypatch.setattr(http, "FIRST_PAUSE", 0.0)
    for name, value in {
        "GITHUB_ACTIONS": "true",
        "GITHUB_EVENT_NAME": "push",
        "GITHUB_REF": "refs/heads/main",
        "GITHUB_REPOSITORY": REPOSITORY,
        "GITHUB_TOKEN": "the token",
        "GITHUB_OUTPUT": str(tmp_path / "outputs"),
        "DOCKER_CONFIG": str(tmp_path),
        "CALIBRATION_SIGNING_KEY": private_pem(),
    }.items():
        monkeypatch.setenv(name, value)
    with services() as found:
        monkeypatch.setenv("GITHUB_API_URL", f"http://{found.server.address}")
        yield found


def deliver(folder: Path, there: Services, *more: str) -> int:
    """Deliver the results of a repository, as a push of their commit does."""
    os.environ["GITHUB_SHA"] = json.loads((folder / "output/results.json").read_text())["commit"]["hash"]
    options = ("--registry", f"{there.server.address}/{IMAGE}", "--release")
    return _run_in(folder, "deliver", *(more or options))


@pytest.fixture
def team(calibrated: Path, tmp_path: Path, there: Services, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GITHUB_SHA", "")  # removed when the test ends
    shutil.copytree(calibrated, tmp_path / "team", symlinks=True)
    return tmp_path / "team"


def test_versions_follow_from_what_changed(
    team: Path, moved: Path, there: Services, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert deliver(team, there) == 0
    assert there.shown == (["1.0.0", "latest"], ["robot-1.0.0"])
    assert deliver(team, there) == 0
    assert "nothing has changed since robot 1.0.0" in capsys.readouterr().out
    assert deliver(moved, there) == 0
    assert there.shown == (["1.0.0", "1.1.0", "latest"], ["robot-1.0.0", "robot-1.1.0"])
    [line] = [line for line in there.changelog("robot-1.1.0").splitlines() if "right\\_camera" in line]
    assert "| minor |" in line
    assert 2.7 < float(line.split("|")[2].split("±")[0]) < 3.3
    assert deliver(team, there) == 0  # the job of the earlier commit ends later
    assert "robot 1.1.0 is of a later commit" in capsys.readouterr().out
    outputs = (tmp_path / "outputs").read_text().splitlines()[-5:]
    assert outputs == ["delivered=false", "version=1.1.0", "change=none", "bundle=", "predicate="]
    (tmp_path / "team.pub").write_bytes(public_pem(KEY))
    for version, code in (("1.1.0", 0), ("1.2", 1)):
        name = f"{there.server.address}/{IMAGE}"
        assert main(["verify", name, "--key", str(tmp_path / "team.pub"), "--at-least", version]) == code


def test_what_broke_off_is_completed_with_the_same_bytes(team: Path, there: Services) -> None:
    there.fault = lambda request: Reply(403) if "/v2/" in request.path and request.method == "PUT" else None
    assert deliver(team, there) == 2
    assert there.shown == ([], [])
    assert there.releases == []
    there.fault = lambda request: Reply(404) if request.path.endswith("/manifests/1.0.0") else None
    assert deliver(team, there) == 2
    assert there.shown == ([], ["robot-1.0.0"])
    there.fault = lambda _: None
    assert deliver(team, there) == 0
    assert there.shown == (["1.0.0", "latest"], ["robot-1.0.0"])
    assert set(there.assets.values()) <= set(there.blobs.values()) | {there.releases[0]["body"].encode()}


def reset(method: str, part: str) -> Callable[[Request], Reply | None]:
    return lambda request: Reply(reset=True) if (request.method, part in request.path) == (method, True) else None


def denied(method: str, part: str) -> Callable[[Request], Reply | None]:
    return lambda request: Reply(403) if (request.method, part in request.path) == (method, True) else None


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (reset("POST", "/releases"), 3),
        (reset("POST", "/assets"), 3),
        (reset("PATCH", "/releases/"), 3),
        (reset("GET", "/releases"), 3),
        (reset("POST", "/blobs/uploads/"), 3),
        (reset("PUT", "/blobs/uploads/"), 3),
        (reset("PUT", "/manifests/sha256:"), 3),
        (denied("POST", "/releases"), 2),
        (denied("POST", "/assets"), 2),
        (denied("PATCH", "/releases/"), 2),
        (denied("POST", "/blobs/uploads/"), 2),
        (denied("PUT", "/manifests/sha256:"), 2),
    ],
)
def test_nothing_is_half_delivered(
    team: Path,
    there: Services,
    fault: Callable[[Request], Reply | None],
    code: int,
    capsys: pytest.CaptureFixture[str],
) -> None:
    there.fault = fault
    assert deliver(team, there) == code
    assert there.shown == ([], [])
    assert there.releases == []
    assert len([line for line in capsys.readouterr().out.splitlines() if line.startswith("::error")]) == 1


def test_a_tag_that_is_taken_is_left_as_it_is(team: Path, there: Services, capsys: pytest.CaptureFixture[str]) -> None:
    there.git_tags.add("robot-1.0.0")
    assert deliver(team, there) == 2
    assert "me/robot: there is a tag robot-1.0.0" in capsys.readouterr().out
    there.git_tags.clear()
    image = b'{"layers": []}'
    there.tags["1.0.0"] = image
    assert deliver(team, there) == 2
    assert there.shown == (["1.0.0"], [])
    assert there.tags["1.0.0"] == image


def test_of_two_at_once_one_delivers(team: Path, there: Services, capsys: pytest.CaptureFixture[str]) -> None:
    def other_release(request: Request) -> Reply | None:
        if request.method == "PATCH":
            there.releases.append({"tag_name": "robot-1.0.0", "draft": False, "body": "the other", "id": 9})
        return None

    there.fault = other_release
    assert deliver(team, there) == 3
    assert "another delivery has taken this version meanwhile" in capsys.readouterr().out
    assert [each["body"] for each in there.releases] == ["the other"]
    assert there.tags == {}
    there.releases.clear()

    def other_tag(request: Request) -> Reply | None:
        if request.method == "PUT" and "/manifests/sha256:" in request.path:
            there.tags["1.0.0"] = b"{}"
        return None

    there.fault = other_tag
    assert deliver(team, there, "--registry", f"{there.server.address}/{IMAGE}") == 3
    assert there.tags == {"1.0.0": b"{}"}


def test_a_folder_has_a_folder_for_each_version(team: Path, moved: Path, there: Services, tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    for folder in (team, team, moved):
        assert deliver(folder, there, "--folder", str(shared)) == 0
    assert sorted(path.name for path in shared.iterdir()) == ["1.0.0", "1.1.0"]
    assert sorted(path.name for path in (shared / "1.1.0").iterdir()) == [
        "CHANGELOG.md",
        "robot.calibration.tar",
        "robot.calibration.tar.intoto.jsonl",
    ]
    assert main(["verify", str(shared / "1.1.0"), "--unsigned"]) == 0
    assert deliver(team, there, "--folder", str(shared), "--serial", "SN-2") == 2  # of another robot
    assert deliver(moved, there, "--folder", str(tmp_path / "new"), "--version", "7") == 0
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["7"]


@pytest.mark.parametrize(
    ("variables", "event", "code"),
    [
        ({"GITHUB_EVENT_NAME": "pull_request", "GITHUB_REF": "refs/pull/7/merge"}, {}, 0),
        ({"GITHUB_EVENT_NAME": "pull_request_target"}, {}, 0),
        ({"GITHUB_EVENT_NAME": "workflow_run"}, {}, 0),
        ({"GITHUB_REF": "refs/heads/feature"}, {}, 0),
        ({"GITHUB_REF": "refs/tags/main"}, {}, 0),
        ({}, {"repository": {"fork": True}}, 0),
        ({"GITHUB_ACTOR": "dependabot[bot]"}, {}, 0),
        ({"GITHUB_ACTIONS": "", "GITHUB_EVENT_NAME": ""}, {}, 2),
    ],
)
def test_only_a_push_to_the_branch_delivers(
    team: Path,
    there: Services,
    tmp_path: Path,
    variables: dict[str, str],
    event: dict[str, Any],
    code: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "event.json").write_text(json.dumps(event))
    monkeypatch.setenv("GITHUB_EVENT_PATH", str(tmp_path / "event.json"))
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert deliver(team, there) == code
    assert there.server.requests == []


def test_results_of_another_commit_are_not_delivered(team: Path, there: Services) -> None:
    os.environ["GITHUB_SHA"] = "0" * 40
    assert _run_in(team, "deliver", "--release") == 2
    assert there.server.requests == []


def test_a_version_that_is_given_must_be_larger(team: Path, moved: Path, there: Services) -> None:
    registry = ("--registry", f"{there.server.address}/{IMAGE}")
    assert deliver(team, there, *registry, "--version", "2.0") == 0
    assert deliver(moved, there, *registry, "--version", "1.9") == 2
    assert deliver(moved, there, *registry, "--version", "2.1") == 0
    assert sorted(there.tags) == ["2.0", "2.1", "latest"]


@pytest.fixture(scope="module")
def content(calibrated: Path) -> bytes:
    """Return a bundle."""
    if not (calibrated / "output/bundle/robot.calibration.tar").exists():
        assert _run_in(calibrated, "bundle") == 0
    return (calibrated / "output/bundle/robot.calibration.tar").read_bytes()


def other_transform(manifest: dict[str, Any]) -> None:
    manifest["systems"][0]["transforms"][0]["child"] = "renamed"


def other_resolution(manifest: dict[str, Any]) -> None:
    manifest["systems"][0]["cameras"][0]["width"] += 1


def other_reasons(manifest: dict[str, Any]) -> None:
    manifest["systems"][0]["reasons"] = ["undecided now"]


def other_time(manifest: dict[str, Any]) -> None:
    manifest.update(made=manifest["made"] + 1, commit="0" * 40, version="9", configuration="0" * 64)


@pytest.mark.parametrize(
    ("change", "level"),
    [(other_transform, "major"), (other_resolution, "major"), (other_reasons, "patch"), (other_time, "none")],
)
def test_the_level_of_a_change(content: bytes, change: Callable[[dict[str, Any]], None], level: Level) -> None:
    files = unpack_files(content)
    manifest = json.loads(files["manifest.json"])
    change(manifest)
    changed = pack_files({**files, "manifest.json": json.dumps(manifest).encode()})
    before, now = (read_contents(FetchedBundle("a", each, None)) for each in (content, changed))
    assert level_of(changes_between(before, now, BaselineSettings().same_data)) == level


def test_on_other_data_within_its_error_bars_it_is_a_patch(content: bytes) -> None:
    before = read_contents(FetchedBundle("a", content, None))
    document = replace(before.calibrations["robot"], data="0" * 64)
    now = replace(before, calibrations={"robot": document})
    assert level_of(changes_between(before, now, BaselineSettings().same_data)) == "patch"


@pytest.mark.parametrize(
    ("version", "level", "then"),
    [("1.4.2", "patch", "1.4.3"), ("1.4.2", "minor", "1.5.0"), ("1.4.2.9", "major", "2.0.0"), ("3", "patch", "3.0.1")],
)
def test_the_version_that_follows(version: str, level: Level, then: str) -> None:
    assert next_version(version, level) == then
