"""Malicious archives are refused with the name of the entry, and nothing is written outside of the folder."""

import hashlib
import io
import os
import tarfile
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import CalibrationError, ExitCode, InfrastructureError
from calibration.ci.execution.extraction import Budget, Extraction, RefusedError, extract
from calibration.ci.execution.outcome import Glob

MIB = 1024**2
ZEROS = b"\0" * MIB


def entry(
    name: str, content: bytes = b"", kind: bytes = tarfile.REGTYPE, link: str = "", size: int | None = None
) -> bytes:
    """Return an entry as its bytes in an archive; the size may be wrong."""
    header = tarfile.TarInfo(name)
    header.type, header.linkname, header.size = kind, link, len(content) if size is None else size
    padding = b"\0" * (-len(content) % 512)
    return header.tobuf(tarfile.PAX_FORMAT, "utf-8", "surrogateescape") + content + padding


END = b"\0" * 1024


def extracted(folder: Path, parts: Iterable[bytes], path: str = "/out/*", budget: Budget | None = None) -> Extraction:
    glob = Glob(path)
    folder.mkdir()
    return extract(parts, glob.landing, glob.source, folder, budget or Budget(MIB, 100))


def archive(*entries: bytes) -> list[bytes]:
    return [entry("out", kind=tarfile.DIRTYPE), *entries, END]


def everything_below(folder: Path) -> dict[str, bytes | None]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")
    }


def test_files_and_folders(tmp_path: Path) -> None:
    result = extracted(
        tmp_path / "to",
        archive(
            entry("out/a.csv", b"1,2\n"),
            entry("out/d", kind=tarfile.DIRTYPE),
            entry("out/d/empty", kind=tarfile.DIRTYPE),
            entry("out/d/ö x", b"x" * 1000),
            entry("out/.hidden", b"no"),
        ),
    )
    assert everything_below(tmp_path / "to") == {
        "a.csv": b"1,2\n",
        "d": None,
        "d/empty": None,
        "d/ö x": b"x" * 1000,
    }
    assert [(file.path, file.size, file.sha256) for file in result.files] == [
        ("a.csv", 4, hashlib.sha256(b"1,2\n").hexdigest()),
        ("d/ö x", 1000, hashlib.sha256(b"x" * 1000).hexdigest()),
    ]
    assert result.seen == [".hidden"]


def test_a_file_by_its_name(tmp_path: Path) -> None:
    result = extracted(tmp_path / "to", [entry("a.csv", b"1"), END], "/out/a.csv")
    assert [file.path for file in result.files] == ["a.csv"]


@pytest.mark.parametrize(
    ("hostile", "message"),
    [
        (entry("/etc/cron.d/x", b"x"), "artifact '/etc/cron.d/x' leaves its folder"),
        (entry("out/../../x", b"x"), "artifact 'out/../../x' leaves its folder"),
        (entry("..", kind=tarfile.DIRTYPE), "leaves its folder"),
        (
            entry("out/x", kind=tarfile.SYMTYPE, link="/etc/passwd"),
            "is a link to '/etc/passwd', which leaves the folder",
        ),
        (entry("out/x", kind=tarfile.SYMTYPE, link="../../etc"), "is a link to '../../etc', which leaves the folder"),
        (entry("out/x", kind=tarfile.SYMTYPE, link="/outside"), "is a link to '/outside', which leaves the folder"),
        (entry("out/x", kind=tarfile.LNKTYPE, link="/etc/passwd"), "artifact '/etc/passwd' leaves its folder"),
        (entry("out/x", kind=tarfile.LNKTYPE, link="out/.y"), "is a hard link to 'out/.y', which is not an artifact"),
        (entry("out/x", kind=tarfile.CHRTYPE), "artifact 'out/x' is no file or folder, but a device or a pipe"),
        (entry("out/x", kind=tarfile.BLKTYPE), "is no file or folder"),
        (entry("out/x", kind=tarfile.FIFOTYPE), "is no file or folder"),
        (
            entry("out/x", size=10 * 1024**3),
            "artifact 'out/x' has 10 GiB: more than the 1 MiB allowed for the artifacts",
        ),
        (entry("out/" + "d/" * 70 + "x", b"x"), "is nested in more than 64 folders"),
        (entry("out/" + "n" * 256, b"x"), "has a name that some file systems do not allow"),
        (entry("out/a\nb", b"x"), r"artifact 'out/a b' has a name that some file systems do not allow"),
        (entry("out/a\x1b[2J", b"x"), r"artifact 'out/a\x1b[2J' has a name"),
        (entry("out/a\udcff", b"x"), "has a name that some file systems do not allow"),
        (entry("out/a\\b", b"x"), "has a name that some file systems do not allow"),
        (entry("out/ok", b"y"), "artifact 'out/ok' has the same target as another file"),
        (entry("out/ok", kind=tarfile.DIRTYPE), "artifact 'ok' is a folder and a file"),
        (entry("out/ok/x", b"y"), "artifact 'ok' is a folder and a file"),
        (entry("out/d", kind=tarfile.DIRTYPE) + entry("out/d", b"y"), "has the same target as another file"),
    ],
)
def test_hostile_entries_are_refused_by_name(tmp_path: Path, hostile: bytes, message: str) -> None:
    with pytest.raises(RefusedError) as caught:
        extracted(tmp_path / "to", archive(entry("out/ok", b"fine"), hostile))
    assert message in str(caught.value)
    assert caught.value.exit_code == ExitCode.FAIL
    assert set(everything_below(tmp_path)) <= {"to", "to/ok", "to/d"}


def test_ten_gigabytes_of_zeros_are_not_read(tmp_path: Path) -> None:
    read = 0

    def stream() -> Iterator[bytes]:
        nonlocal read
        yield entry("out", kind=tarfile.DIRTYPE) + entry("out/zeros", size=10 * 1024**3)
        for _ in range(10 * 1024):
            read += 1
            yield ZEROS

    with pytest.raises(RefusedError, match="'out/zeros' has 10 GiB"):
        extracted(tmp_path / "to", stream())
    assert read <= 1
    read = 0
    with pytest.raises(RefusedError, match=r"'out/zeros' and others beside the artifacts in /out are too large"):
        extracted(tmp_path / "beside", stream(), "/out/*.csv")
    assert read <= 1


def test_a_header_without_an_end_is_not_read(tmp_path: Path) -> None:
    read = 0

    def stream() -> Iterator[bytes]:
        nonlocal read
        yield entry("x", kind=tarfile.XHDTYPE, size=7 * 1024**3)
        while True:
            read += 1
            yield ZEROS

    with pytest.raises(InfrastructureError, match="a header has no end"):
        extracted(tmp_path / "to", stream())
    assert read <= 4


def test_the_sum_counts(tmp_path: Path) -> None:
    files = [entry(f"out/{i}", b"x" * 600_000) for i in range(2)]
    with pytest.raises(RefusedError, match=r"'out/1' has 585\.9 KiB: more than the 1 MiB"):
        extracted(tmp_path / "size", archive(*files))
    many = [entry(f"out/{i}") for i in range(101)]
    with pytest.raises(RefusedError, match="'out/100' exceeds the limit of 100 artifacts"):
        extracted(tmp_path / "count", archive(*many))


def test_links_inside_are_noted_and_hard_links_copied(tmp_path: Path) -> None:
    result = extracted(
        tmp_path / "to",
        archive(
            entry("out/a", b"content"),
            entry("out/b", kind=tarfile.LNKTYPE, link="out/a"),
            entry("out/latest", kind=tarfile.SYMTYPE, link="a"),
            entry("out/d/up", kind=tarfile.SYMTYPE, link="../a"),
            entry("out/absolute", kind=tarfile.SYMTYPE, link="/out/a"),
        ),
    )
    assert everything_below(tmp_path / "to") == {"a": b"content", "b": b"content"}
    assert result.left_out == [
        "'out/latest' is a link to 'a'",
        "'out/d/up' is a link to '../a'",
        "'out/absolute' is a link to '/out/a'",
    ]
    (tmp_path / "to" / "b").write_bytes(b"other")
    assert (tmp_path / "to" / "a").read_bytes() == b"content"  # copies, not links


def test_a_hard_link_counts_too(tmp_path: Path) -> None:
    links = [entry(f"out/{i}", kind=tarfile.LNKTYPE, link="out/a") for i in range(3)]
    with pytest.raises(RefusedError, match="'out/0' has 585"):
        extracted(tmp_path / "to", archive(entry("out/a", b"x" * 600_000), *links))


@pytest.mark.parametrize(
    "broken",
    [
        [b""],
        [b"no archive at all" * 100],
        [entry("out/a", b"x" * 1000)[:-900]],
        [entry("out/a", b"x" * 100, size=5000)],
        [entry("out/a", b"x" * 512)],
    ],
)
def test_a_stream_that_breaks_is_no_success(tmp_path: Path, broken: list[bytes]) -> None:
    with pytest.raises(InfrastructureError, match=r"the archive of the artifacts (is broken|ends too early)"):
        extracted(tmp_path / "to", broken)


@pytest.mark.parametrize("content", [entry("out/a", b"x"), entry("out/d", kind=tarfile.DIRTYPE)])
def test_a_folder_that_cannot_be_written(tmp_path: Path, content: bytes) -> None:
    glob = Glob("/out/*")
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    with pytest.raises(CalibrationError, match=r"an artifact cannot be written|is a folder and a file"):
        extract(archive(content), glob.landing, glob.source, loop / "x", Budget(MIB, 9))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = io.FileIO
    monkeypatch.setattr(io, "FileIO", lambda _path, _mode: plain("/dev/full", "w"))
    with pytest.raises(InfrastructureError, match="an artifact cannot be written: No space left on device"):
        extracted(tmp_path / "to", archive(entry("out/a", b"x")))


NAMES = st.sampled_from(["out", "out/a", "out/b", "out/d", "out/d/x", "../x", "/x", "out/d/../../y", "x", "out/é", ""])
KINDS = st.sampled_from([tarfile.REGTYPE, tarfile.DIRTYPE, tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE, b"Z"])
ENTRIES = st.tuples(NAMES, st.binary(max_size=20), KINDS, NAMES)


@given(st.lists(ENTRIES, max_size=6), st.lists(st.tuples(st.integers(0, 8000), st.integers(0, 255)), max_size=4))
def test_whatever_comes_nothing_is_written_outside(
    entries: list[tuple[str, bytes, bytes, str]], damage: list[tuple[int, int]]
) -> None:
    data = bytearray(b"".join(archive(*(entry(name, content, kind, link) for name, content, kind, link in entries))))
    for place, value in damage:
        data[place % len(data)] = value
    with tempfile.TemporaryDirectory() as temporary:
        outer = Path(temporary)
        try:
            result = extracted(outer / "to", [bytes(data)])
        except CalibrationError:
            result = None
        assert [path.name for path in outer.iterdir()] == ["to"]
        below = [Path(root, name) for root, _, names in os.walk(outer / "to") for name in names]
        assert all(path.is_file() and not path.is_symlink() for path in below)
        if result is not None:
            assert {path.relative_to(outer / "to").as_posix() for path in below} == {f.path for f in result.files}


def test_archives_of_the_standard_library_are_read(tmp_path: Path) -> None:
    source = tmp_path / "out"
    (source / "deep" / ("long" * 40)).mkdir(parents=True)
    (source / "deep" / ("long" * 40) / "x").write_bytes(os.urandom(300_000))
    for form in (tarfile.PAX_FORMAT, tarfile.GNU_FORMAT):
        file = io.BytesIO()
        with tarfile.open(fileobj=file, mode="w", format=form) as written:
            written.add(source, "out")
        data = file.getvalue()
        chunks = [data[i : i + 7777] for i in range(0, len(data), 7777)]
        assert len(extracted(tmp_path / f"to{form}", chunks).files) == 1
