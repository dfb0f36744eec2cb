"""Reading of an untrusted volume, without following links out of it."""

import os
import socket
from pathlib import Path
from typing import Any

import pytest

from calibration.addons.aws_batch.inside.local_archive import opener_of
from calibration.base import InfrastructureError
from calibration.ci.execution.extraction import Budget, Extraction, RefusedError, extract
from calibration.ci.execution.job import OUTPUT
from calibration.ci.execution.outcome import Glob, NothingThereError


def taken(output: Path, path: str, to: Path) -> Extraction:
    glob = Glob(path)
    to.mkdir(exist_ok=True)
    with opener_of(output)(glob.source) as archive:
        assert archive.link == ""
        return extract(archive.chunks, glob.landing, glob.source, to, Budget(10**7, 1000))


@pytest.fixture
def output(tmp_path: Path) -> Path:
    output = tmp_path / "output"
    (output / "run-7" / "deep").mkdir(parents=True)
    (output / "run-7" / "a.csv").write_bytes(b"1,2")
    (output / "run-7" / "deep" / "b").write_bytes(b"x" * 3_000_000)
    (output / "empty").write_bytes(b"")
    (tmp_path / "secret").write_text("s3cret")
    (tmp_path / "secrets").mkdir()
    (tmp_path / "secrets" / "a.csv").write_text("s3cret")
    return output


@pytest.mark.parametrize(
    ("path", "found"),
    [
        (f"{OUTPUT}/*", {"empty", "run-7/a.csv", "run-7/deep/b"}),
        (OUTPUT, {"output/empty", "output/run-7/a.csv", "output/run-7/deep/b"}),
        (f"{OUTPUT}/empty", {"empty"}),
        (f"{OUTPUT}/run-7/*.csv", {"a.csv"}),
        (f"{OUTPUT}/run-7/deep", {"deep/b"}),
        (f"{OUTPUT}/latest/*.csv", {"a.csv"}),
        (f"{OUTPUT}/latest", {"latest/a.csv", "latest/deep/b"}),
        (f"{OUTPUT}/absolute/deep/*", {"b"}),
        (f"{OUTPUT}/round/run-7/deep/*", {"b"}),
        (f"{OUTPUT}/file", {"file"}),
    ],
)
def test_found_by_any_way_inside(output: Path, tmp_path: Path, path: str, found: set[str]) -> None:
    for name, to in {"latest": "run-7", "absolute": f"{OUTPUT}/run-7", "round": "../output/.", "file": "empty"}.items():
        (output / name).symlink_to(to)
    result = taken(output, path, tmp_path / "to")
    assert {file.path for file in result.files} == found
    for file in result.files:
        assert (tmp_path / "to" / file.path).stat().st_size == file.size


def test_the_content_is_the_same(output: Path, tmp_path: Path) -> None:
    (output / os.fsdecode(b"a\xff")).write_text("no text")
    with pytest.raises(RefusedError, match="has a name that some file systems do not allow"):
        taken(output, f"{OUTPUT}/*", tmp_path / "to")
    result = taken(output, f"{OUTPUT}/run-7/*", tmp_path / "to2")
    assert (tmp_path / "to2" / "deep" / "b").read_bytes() == b"x" * 3_000_000
    assert result.left_out == []


@pytest.mark.parametrize("path", [f"{OUTPUT}/nosuch", f"{OUTPUT}/empty/x/*", f"{OUTPUT}/dangling/*"])
def test_missing_objects(output: Path, tmp_path: Path, path: str) -> None:
    (output / "dangling").symlink_to("nosuch")
    with pytest.raises(NothingThereError):
        taken(output, path, tmp_path / "to")


def test_a_volume_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(NothingThereError):
        taken(tmp_path / "none", f"{OUTPUT}/*", tmp_path / "to")


@pytest.mark.parametrize("to", ["../secret", "/etc", "../secrets", "run-7/../../secrets", "circle"])
def test_a_way_out_is_refused(output: Path, tmp_path: Path, to: str) -> None:
    (output / "circle").symlink_to(to)
    with pytest.raises(RefusedError, match=f"artifact '{OUTPUT}/circle' is behind a link to '.*', which leaves the"):
        taken(output, f"{OUTPUT}/circle/*.csv", tmp_path / "to")
    assert list((tmp_path / "to").iterdir()) == []


@pytest.mark.parametrize("path", ["/etc/passwd", "/calibration/output2/x", f"{OUTPUT}/../job/x"])
def test_nothing_but_the_volume_is_reached(output: Path, tmp_path: Path, path: str) -> None:
    with pytest.raises(RefusedError, match="is not below /calibration/output"), opener_of(output)(path):
        pass


def test_special_files(output: Path, tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(output / "s"))
        with pytest.raises(RefusedError, match="'output/s' is no file or folder, but a device or a pipe"):
            taken(output, f"{OUTPUT}/*", tmp_path / "to")


def test_a_link_that_is_put_in_the_place_of_a_folder(output: Path, tmp_path: Path) -> None:
    """During reading; it must not be followed."""
    glob = Glob(f"{OUTPUT}/*")
    with opener_of(output)(glob.source) as archive:
        first = next(archive.chunks)  # the folder itself
        (output / "run-7").rename(tmp_path / "away")
        (output / "run-7").symlink_to(tmp_path / "secrets")
        rest = b"".join(archive.chunks)
    assert b"s3cret" not in first + rest
    with opener_of(output)(f"{OUTPUT}/empty") as archive:
        (output / "empty").unlink()
        with pytest.raises(InfrastructureError, match="artifact 'empty' cannot be read: No such file"):
            next(archive.chunks)


@pytest.mark.parametrize("name", ["empty", "run-7"])
def test_a_link_that_comes_between_the_look_and_the_reading(
    output: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    really = os.stat

    def look(path: str, **settings: Any) -> os.stat_result:
        found = really(path, **settings)
        if path == name:
            (output / name).rename(tmp_path / "away")
            (output / name).symlink_to(tmp_path / ("secret" if name == "empty" else "secrets"))
        return found

    with opener_of(output)(OUTPUT) as archive:
        monkeypatch.setattr(os, "stat", look)
        with pytest.raises(
            InfrastructureError, match=r"cannot be read: (Too many levels of symbolic links|Not a directory)"
        ):
            list(archive.chunks)
        monkeypatch.undo()


def test_a_file_that_becomes_shorter(output: Path) -> None:
    with opener_of(output)(f"{OUTPUT}/run-7/deep/b") as archive:
        next(archive.chunks)
        next(archive.chunks)
        (output / "run-7" / "deep" / "b").write_bytes(b"")
        with pytest.raises(InfrastructureError, match="artifact 'b' became shorter while it was read"):
            list(archive.chunks)


def test_an_error_of_the_disk(output: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "stat", fails)
    with (
        pytest.raises(InfrastructureError, match="cannot be read: Input/output error"),
        opener_of(output)(f"{OUTPUT}/empty"),
    ):
        pass
