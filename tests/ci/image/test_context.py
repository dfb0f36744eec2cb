import io
import os
import socket
import tarfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InfrastructureError, InputError
from calibration.ci.image.context import FILE_TIME, NO_SOURCES, Context, Ignored, content_key, key_tag, read_ignore_file


def packed(context: Context) -> bytes:
    target = io.BytesIO()
    context.write_tar(target)
    return target.getvalue()


def names(context: Context) -> list[str]:
    with tarfile.open(fileobj=io.BytesIO(packed(context))) as archive:
        return archive.getnames()


def of_folder(folder: Path, *rules: str) -> Context:
    context = Context()
    context.add_folder("", folder, "context", Ignored(rules))
    return context


def key(context: Context, **other: object) -> str:
    given = {
        "dockerfile": "D",
        "bases": {"a": "1"},
        "platforms": ["linux/amd64"],
        "build_arguments": {},
        "target": None,
        "labels": {},
    }
    return content_key(context, **{**given, **other})  # type: ignore[arg-type]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    root = tmp_path / "root"
    (root / "sub" / "deep").mkdir(parents=True)
    (root / "a.py").write_text("a")
    (root / "run.sh").write_text("#!/bin/sh")
    (root / "run.sh").chmod(0o700)
    (root / "sub" / "b.bin").write_bytes(bytes(range(256)))
    (root / "sub" / "deep" / "link").symlink_to("../b.bin")
    return root


def test_the_archive_contains_no_owners_and_times(folder: Path) -> None:
    with tarfile.open(fileobj=io.BytesIO(packed(of_folder(folder)))) as archive:
        found = {member.name: member for member in archive}
        assert {member.mtime for member in found.values()} == {FILE_TIME}
        assert {(m.uid, m.gid, m.uname, m.gname) for m in found.values()} == {(0, 0, "", "")}
        assert {name: oct(member.mode) for name, member in found.items()} == {
            "a.py": "0o644",
            "run.sh": "0o755",
            "sub": "0o755",
            "sub/b.bin": "0o644",
            "sub/deep": "0o755",
            "sub/deep/link": "0o777",
        }
        assert found["sub/deep/link"].linkname == "../b.bin"
        content = archive.extractfile("sub/b.bin")
        assert content is not None
        assert content.read() == bytes(range(256))


def test_same_contents_same_bytes_and_key(folder: Path, tmp_path: Path) -> None:
    first, before = packed(of_folder(folder)), key(of_folder(folder))
    os.utime(folder / "a.py", (1, 1))
    (folder / "a.py").chmod(0o600)
    folder.rename(tmp_path / "elsewhere")
    assert packed(of_folder(tmp_path / "elsewhere")) == first
    assert key(of_folder(tmp_path / "elsewhere")) == before


def test_the_key_changes_with_all_that_the_image_is_made_of(folder: Path) -> None:
    context = of_folder(folder)
    keys = {
        key(context),
        key(context, dockerfile="E"),
        key(context, bases={"a": "2"}),
        key(context, bases={"b": "1"}),
        key(context, platforms=["linux/arm64"]),
        key(context, build_arguments={"A": "1"}),
        key(context, target="x"),
        key(context, labels={"a": "1"}),
    }
    for change in (
        lambda: (folder / "a.py").write_text("b"),
        lambda: (folder / "a.py").chmod(0o755),
        lambda: (folder / "a.py").rename(folder / "c.py"),
        lambda: (folder / "sub" / "deep" / "link").unlink(),
        lambda: (folder / "sub" / "deep" / "link").symlink_to("../../run.sh"),
        lambda: (folder / "empty").mkdir(),
    ):
        change()
        keys.add(key(of_folder(folder)))
    assert len(keys) == 14


def test_the_tag_of_a_key() -> None:
    assert key_tag("0123456789abcdef" * 4) == "key-0123456789abcdef01234567"


def test_ignored_files_and_exceptions(folder: Path) -> None:
    (folder / ".git").mkdir()
    (folder / ".git" / "HEAD").write_text("x")
    (folder / "sub" / ".git").write_text("gitdir: x")
    found = names(of_folder(folder, *NO_SOURCES, "sub/*", "!sub/b.bin", "*.sh"))
    assert found == ["a.py", "sub", "sub/b.bin"]


def test_the_folder_of_results_is_no_part_of_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    context = Context([Path("sub")])
    context.add_folder("x", Path(), "context", Ignored())
    assert names(context) == ["x", "x/a.py", "x/run.sh"]


def test_only_some_names(folder: Path) -> None:
    (folder / "sub" / "package.xml").write_text("<package/>")
    (folder / "package.xml").symlink_to("a.py")
    context = Context()
    context.add_folder("m", folder, "sources", Ignored(), only=frozenset({"package.xml"}))
    assert names(context) == ["m", "m/sub/package.xml"]


def test_the_ignore_file(tmp_path: Path) -> None:
    file = tmp_path / ".dockerignore"
    assert read_ignore_file(file) == []
    file.write_text("\ufeff# note\n\n*.log \n!keep.log\r\n")
    assert read_ignore_file(file) == ["*.log", "!keep.log"]
    file.write_bytes(b"\xff")
    with pytest.raises(InputError, match="no text in UTF-8"):
        read_ignore_file(file)


@pytest.mark.parametrize("target", ["/etc/passwd", "../../secret", "..", "a/../../x"])
def test_links_that_leave_are_refused_by_name(folder: Path, target: str) -> None:
    (folder / "evil").symlink_to(target)
    with pytest.raises(InputError, match=r"sources: the link .*/evil points to .*, which is outside"):
        Context().add_folder("x", folder, "sources", Ignored())


def test_links_are_not_followed(folder: Path) -> None:
    (folder / "loop").symlink_to(".")
    assert "loop/a.py" not in names(of_folder(folder))


def test_special_files_are_refused_by_name(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    with socket.socket(socket.AF_UNIX) as found:
        found.bind("agent.sock")
        with pytest.raises(InputError, match=r"context: .*/agent.sock is neither file, folder nor link"):
            of_folder(folder)


def test_missing_and_misplaced(folder: Path) -> None:
    with pytest.raises(InputError, match=r"files: .*/nothing cannot be read: No such file"):
        Context().add_file("a", folder / "nothing", "files")
    with pytest.raises(InputError, match="is no regular file"):
        Context().add_file("a", folder, "files")
    with pytest.raises(InputError, match="is no folder"):
        Context().add_folder("a", folder / "a.py", "sources", Ignored())
    with pytest.raises(InputError, match="cannot be read"):
        Context().add_file("a", Path("a\0b"), "files")


def test_too_large_names_the_largest(tmp_path: Path) -> None:
    for name, size in (("small", 10), ("big.bag", 3_000_000), ("medium", 500_000)):
        with (tmp_path / name).open("wb") as file:
            file.truncate(size)
    context = Context(max_bytes=2_000_000)
    with pytest.raises(InputError, match=r"larger than 2 MB; the largest: .*big.bag \(3 MB\): leave out"):
        context.add_folder("", tmp_path, "context", Ignored())
    with pytest.raises(InputError, match="more than 2 files"):
        Context(max_files=2).add_folder("", tmp_path, "context", Ignored())


def test_a_file_that_is_gone_or_shorter_at_the_build(folder: Path) -> None:
    context = of_folder(folder)
    (folder / "a.py").write_text("")
    with pytest.raises(InfrastructureError, match=r"a\.py: the build context cannot be written"):
        packed(context)
    (folder / "a.py").unlink()
    with pytest.raises(InfrastructureError, match=r"a.py: cannot be read for the build"):
        packed(context)
    with pytest.raises(InfrastructureError, match=r"a.py: cannot be read for the build"):
        key(context)


def test_written_as_a_folder(folder: Path, tmp_path: Path) -> None:
    context = of_folder(folder, "sub/deep", "!sub/deep/link")
    context.add_bytes("Dockerfile", b"FROM x")
    target = tmp_path / "new" / "context"
    context.write_folder(target)
    assert packed(of_folder(target)) == packed(context_with_parents(context))
    with pytest.raises(InputError, match="an empty folder was expected"):
        context.write_folder(target)
    with pytest.raises(InfrastructureError, match="cannot be written"):
        context.write_folder(Path("/proc/nothing"))


def context_with_parents(context: Context) -> Context:
    """Return the context with the parent folders of its files, which an exception may have excluded."""
    from calibration.ci.image.context import Entry

    context.entries.setdefault("sub/deep", Entry(0o755))
    return context


def test_names_that_are_no_text(tmp_path: Path) -> None:
    name = os.fsdecode(b"caf\xe9")
    (tmp_path / name).write_text("x")
    context = of_folder(tmp_path)
    assert names(context) == [name]
    assert len(key(context)) == 64


@given(st.dictionaries(st.from_regex(r"[a-z]{1,3}(/[a-z]{1,3}){0,2}", fullmatch=True), st.binary(max_size=5)))
def test_the_order_in_which_files_are_added_does_not_matter(files: dict[str, bytes]) -> None:
    one, other = Context(), Context()
    for name, content in files.items():
        one.add_bytes(name, content)
    for name, content in reversed(files.items()):
        other.add_bytes(name, content)
    assert packed(one) == packed(other)
    assert key(one) == key(other)
