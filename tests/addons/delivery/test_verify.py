"""``verify``: exit codes, folders, options, what it remembers, and what it needs to start."""

import hashlib
import json
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.addons.delivery.destinations import ARTIFACT_TYPE, ATTESTATION_LAYER, BUNDLE_LAYER
from calibration.base import http
from tests.ci.registries.server import Reply, Request, serve

from .bundles import (
    DESCRIPTION,
    MADE,
    MANIFEST,
    NAME,
    OTHER_KEY,
    SYSTEM,
    camera_info,
    messages,
    packed,
    private_pem,
    public_pem,
    signed,
    write_bundle_files,
    write_yaml,
)

ROOT = Path(__file__).parents[3]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder, with a signed bundle."""
    write_bundle_files(tmp_path, signed(packed()))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(time, "time", lambda: MADE + 86400.0)
    return tmp_path


def verify(*arguments: str, bundle: str = NAME, key: str = "key.pub") -> int:
    return main(["verify", bundle, "--key", key, *arguments])


def results() -> dict[str, object]:
    found: dict[str, object] = json.loads(Path("output/results.json").read_text())
    return found


def test_a_good_bundle_passes_and_says_what_was_not_compared(folder: Path) -> None:
    (folder / "robot.urdf").write_bytes(DESCRIPTION)
    options = ("--serial", "SN-1", "--description", "robot.urdf", "--max-age", "30d", "--at-least", "1.4.0")
    assert verify(*options, "--offline", "--output", "output") == 0
    found = results()
    assert (found["verdict"], found["name"], found["version"], found["age_days"]) == ("pass", "robot", "1.4", 1.0)
    assert found["warnings"] == ["what is in use is not compared: give its files by --in-use"]


@pytest.mark.parametrize(
    "options",
    [
        ("--serial", "SN-2"),
        ("--description", "key.pub"),
        ("--description", "empty.urdf"),
        ("--max-age", "12h"),
        ("--at-least", "1.4.0.1"),
        ("--key", "other.pub"),
    ],
)
def test_a_bundle_that_is_not_as_expected_is_refused(folder: Path, options: tuple[str, ...]) -> None:
    write_bundle_files(folder, signed(packed()))
    (folder / "empty.urdf").touch()
    (folder / "other.pub").write_bytes(public_pem(OTHER_KEY))
    assert verify(*options, "--output", "output") == 1
    assert len(results()["reasons"]) == 1  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["verify", NAME], "expected --key"),
        (["verify", NAME, "--unsigned", "false"], "expected --key"),
        (["verify", NAME, "--key", "key.pub", "--unsigned"], "unsigned: found --key too"),
        (["verify", "nowhere.tar", "--key", "key.pub"], "nowhere.tar: a bundle was expected"),
        (["verify", "ghcr.io/a/b:1", "--key", "key.pub", "--offline"], "--offline allows no registry"),
        (["verify", NAME, "--key", NAME], f"{NAME}: expected an unencrypted public key in PEM"),
        (["verify", NAME, "--key", "private.pem"], "private.pem: expected an unencrypted public key in PEM"),
        (["verify", NAME, "--key", "key.pub", "--max-age", "soon"], "options: max-age: found 'soon'"),
        (["verify", NAME, "--key", "key.pub", "--at-least", "v1"], "options: at-least: found 'v1'"),
        (["verify", NAME, "--key", "key.pub", "--systems", "sterio"], "did you mean 'stereo'?"),
        (["verify", NAME, "--key", "key.pub", "--in-use", "left_camra=a.yaml"], "did you mean 'left_camera'?"),
        (["verify", NAME, "--key", "key.pub", "--in-use", "a.yaml"], "a.yaml: a URDF"),
        (["verify", NAME, "--key", "key.pub", "--attestation", "a"], "a: an attestation was expected"),
        (["verify", NAME, "--key", "key.pub", "--unpack", "."], "expected a new folder to unpack to"),
        (["verify", ".", "--key", "key.pub"], ".: found 2 bundles"),
        (["verify", NAME, "--key", "key.pub", "--remember", "key.pub"], "key.pub: "),
    ],
)
def test_wrong_inputs_are_errors_of_one_line(
    folder: Path, arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "private.pem").write_text(private_pem())
    shutil.copy(folder / NAME, folder / "b.calibration.tar")
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1


def test_what_is_in_use_is_compared(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_yaml(folder / "tf.yaml", messages(*SYSTEM.transforms[:2]))
    write_yaml(folder / "left.yaml", camera_info(SYSTEM.cameras[0]))
    write_yaml(folder / "right.yaml", camera_info(SYSTEM.cameras[1]))
    right = "left_camera=left.yaml,right_camera=right.yaml"
    assert verify("--in-use", f"tf.yaml,{right}") == 0
    capsys.readouterr()
    assert verify("--in-use", "left_camera=right.yaml,right_camera=left.yaml", "--output", "output") == 1
    differences = results()["differences"]
    assert [each["of"] for each in differences] == ["left_camera", "right_camera"]  # type: ignore[attr-defined]
    moved = messages(replace(SYSTEM.transforms[0], trans=(0.1, 0.2, 0.3001)), SYSTEM.transforms[1])
    write_yaml(folder / "tf.yaml", moved)
    assert verify("--in-use", "tf.yaml") == 1
    assert "error: tf.yaml: left: found it 0.1 mm" in capsys.readouterr().err
    assert verify("--in-use", "tf.yaml", "--tolerance-mm", "0.2") == 0


def test_an_unpacked_bundle_is_verified_as_the_archive_was(folder: Path) -> None:
    assert verify("--unpack", "robot") == 0
    assert {path.name for path in (folder / "robot").rglob("*") if path.is_file()} == {
        *("manifest.json", "attestation.intoto.jsonl", "tf_static.yaml", "calibration.json")
    }
    assert verify(bundle="robot") == 0
    (folder / "robot/stereo/tf_static.yaml").chmod(0o600)
    assert verify(bundle="robot") == 0
    (folder / "robot/stereo/more").write_text("")
    assert verify(bundle="robot") == 1
    (folder / "robot/stereo/more").unlink()
    (folder / "robot/link").symlink_to("manifest.json")
    assert verify(bundle="robot", key="key.pub") == 1
    (folder / "robot/link").unlink()
    (folder / "robot/stereo/tf_static.yaml").write_text("transforms: [] \n")
    assert verify(bundle="robot") == 1


def test_a_folder_with_one_bundle_is_that_bundle(folder: Path) -> None:
    assert verify(bundle=".") == 0


def test_a_refused_bundle_is_not_unpacked(folder: Path) -> None:
    assert verify("--unpack", "robot", "--serial", "SN-2") == 1
    assert not (folder / "robot").exists()


def test_an_older_one_than_was_ever_accepted_is_refused(folder: Path) -> None:
    later = replace(MANIFEST, version="1.10")
    (folder / "later").mkdir()
    write_bundle_files(folder / "later", signed(packed(later), later))
    assert verify("--remember", "state/version") == 0
    assert verify("--remember", "state/version", bundle=f"later/{NAME}") == 0
    assert (folder / "state/version").read_text() == "1.10\n"
    assert verify("--remember", "state/version") == 1
    assert verify("--remember", "state/version", bundle=f"later/{NAME}") == 0


def test_without_a_signature_it_says_so(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / f"{NAME}.intoto.jsonl").unlink()
    assert verify() == 1
    assert main(["verify", NAME, "--unsigned"]) == 0
    assert "its signature is not checked" in capsys.readouterr().err


def test_neither_numpy_nor_a_client_of_networks_is_imported(folder: Path) -> None:
    write_yaml(folder / "tf.yaml", messages(*SYSTEM.transforms[:2]))
    heavy = ("numpy", "requests", "docker", "rosbags", "defusedxml", "rich", "urllib3")
    script = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); from calibration.__main__ import main\n"
        f"code = main(['verify', '{NAME}', '--key', 'key.pub', '--in-use', 'tf.yaml'])\n"
        f"assert not sys.modules.keys() & set({heavy!r}), sys.modules.keys() & set({heavy!r})\n"
        "sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_a_bundle_in_a_registry_is_verified(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DOCKER_CONFIG", str(folder))
    fetched = signed(packed())
    blobs = {
        f"sha256:{hashlib.sha256(each).hexdigest()}": each for each in (fetched.content, fetched.attestation or b"")
    }
    layers = [
        {"mediaType": kind, "digest": name} for kind, name in zip((BUNDLE_LAYER, ATTESTATION_LAYER), blobs, strict=True)
    ]
    manifest = json.dumps({"schemaVersion": 2, "artifactType": ARTIFACT_TYPE, "layers": layers}).encode()
    changed: dict[str, bytes] = {}

    def answer(request: Request) -> Reply:
        name = request.path.rpartition("/")[2]
        if "/manifests/" in request.path:
            kind = {"Content-Type": "application/vnd.oci.image.manifest.v1+json"}
            return Reply(200, manifest, kind) if name == "v1" else Reply(404)
        return Reply(200, {**blobs, **changed}[name])

    with serve(answer) as server:
        assert verify(bundle=f"{server.address}/team/robot:v1") == 0
        assert verify(bundle=f"{server.address}/team/robot:v2") == 2
        assert "found no such file, folder or artifact of a registry" in capsys.readouterr().err
        changed[next(iter(blobs))] = b"other"
        assert verify(bundle=f"{server.address}/team/robot:v1") == 3
    monkeypatch.setattr(http, "MAX_ATTEMPTS", 1)
    assert verify(bundle=f"{server.address}/team/robot:v1") == 3
