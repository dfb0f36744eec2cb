"""Small files that would unpack to gigabytes: refused by what their headers say, or where the limit is reached."""

import bz2
import os
import signal
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import lz4.frame
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode
from rosbags.rosbag2.reader import zstd

from calibration import MAX_IMAGE_PIXELS
from calibration.base import InputError
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.robot.importing.bags.bag import UnpackingBudget, UnpackingError, open_bag
from calibration.robot.importing.bags.messages import depth_of, image_of
from calibration.robot.importing.image_views import read_image
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.marked_boards import CharucoDetector
from tests.campaigns.fuzz import bounded
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind

SECONDS, MEMORY = 60, 1 << 30
ZEROS = bytes(1 << 24)


@pytest.fixture(autouse=True)
def little_memory() -> Iterator[None]:
    with bounded(SECONDS, MEMORY):
        yield


def _png(width: int, height: int, bits: int, colour: int, data: bytes) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def _tiff(width: int, height: int) -> bytes:
    data = zlib.compress(ZEROS)
    tags = [(256, width), (257, height), (258, 8), (259, 8), (262, 1), (273, 134), (277, 1), (278, height)]
    tags += [(279, len(data)), (339, 1)]
    return (
        b"II*\0"
        + struct.pack("<IH", 8, 10)
        + b"".join(struct.pack("<HHII", *(t, 4, 1, v)) for t, v in tags)
        + bytes(4)
        + data
    )


@pytest.mark.parametrize(
    "data",
    [
        _png(16384, 65535, 1, 0, zlib.compress(ZEROS)),
        _png(30000, 30000, 8, 2, zlib.compress(ZEROS)),
        _png(10_001, 10_000, 16, 0, zlib.compress(ZEROS)),
        _tiff(30000, 30000),
        b"P5 40000 40000 255\n",
    ],
    ids=["bits", "colours", "16", "tiff", "pgm"],
)
def test_an_image_of_too_many_pixels_is_refused_by_its_header(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "image.png").write_bytes(data)
    with pytest.raises(InputError, match=r"image\.png: this image is too large, expected 75000000 pixels at most"):
        read_image(tmp_path / "image.png")


def test_the_largest_image_of_16_bits_is_read_and_searched_in_little_memory(tmp_path: Path) -> None:
    width, height = 10_000, MAX_IMAGE_PIXELS // 10_000
    packed, row = zlib.compressobj(1), bytes(1 + 6 * width)
    data = b"".join([packed.compress(row) for _ in range(height)] + [packed.flush()])
    (tmp_path / "image.png").write_bytes(_png(width, height, 16, 2, data))
    image = read_image(tmp_path / "image.png")
    assert (image.shape, image.dtype) == ((height, width, 3), np.uint8)
    board = PatternConfiguration(
        "board", "charuco", "board", "world", True, (8, 6), 0.1, inner_size=0.08, dictionary="DICT_5X5_100"
    )
    assert isinstance(CharucoDetector(board).detect(image), NotDetected)


def test_an_image_in_a_bag_is_refused_by_its_header() -> None:
    message = SimpleNamespace(format="png", data=np.frombuffer(_png(30000, 30000, 8, 2, b""), np.uint8))
    with pytest.raises(InputError, match=r"^left \(png\): this image is too large"):
        image_of(message, "left")
    message.format = "16UC1; compressedDepth png"
    message.data = np.frombuffer(bytes(12) + _png(6000, 6000, 16, 0, zlib.compress(bytes(72_006_000))), np.uint8)
    with pytest.raises(InputError, match="left: found an image of 6000 x 6000 pixels, expected 1 to 16777216"):
        depth_of(message, "left")


def test_a_row_that_is_said_to_be_longer_than_the_image_takes_no_memory() -> None:
    data = np.arange(12, dtype=np.uint8)
    message = SimpleNamespace(encoding="mono8", height=1, width=12, step=1 << 32, is_bigendian=0, data=data)
    assert image_of(message, "left").tolist() == [data.tolist()]


def _record(op: int, body: bytes) -> bytes:
    return bytes([op]) + struct.pack("<Q", len(body)) + body


def _text(text: bytes) -> bytes:
    return struct.pack("<I", len(text)) + text


def _mcap(path: Path, compression: bytes, packed: bytes, size: int) -> None:
    chunk = struct.pack("<QQQI", 0, 1, size, 0) + _text(compression) + struct.pack("<Q", len(packed)) + packed
    records = (
        _record(1, _text(b"ros2") + _text(b"x")) + _record(6, chunk) + _record(15, bytes(4)) + _record(2, bytes(20))
    )
    path.write_bytes(b"\x89MCAP0\r\n" + records + b"\x89MCAP0\r\n")


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_of_mcap_is_unpacked_up_to_a_limit(compression: str, tmp_path: Path) -> None:
    packed = zstd.ZstdCompressor() if compression == "zstd" else lz4.frame.LZ4FrameCompressor()
    parts = [] if compression == "zstd" else [packed.begin()]
    parts += [packed.compress(ZEROS) for _ in range(64)] + [packed.flush()]
    _mcap(tmp_path / "bomb.mcap", compression.encode(), b"".join(parts), 64 * len(ZEROS))
    said = "than 250 times its size" if compression == "zstd" else "more than 268435456 bytes"
    with (
        pytest.raises(InputError, match=rf"bomb\.mcap: this bag cannot be read: .*{said}"),
        open_bag([tmp_path / "bomb.mcap"]),
    ):
        pass


def _of_compression(path: Path, kind: Kind, compression: str, sizes: int = 3) -> Path:
    """A bag of images of one colour each."""
    bag = BagFile(path, kind)
    if compression in ("bz2", "lz4"):
        bag.writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    else:
        bag.writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with bag:
        for n in range(sizes):
            bag.image("/image", BEGIN + n * SECOND, np.full((600, 800, 3), n, np.uint8), "left")
    return path


COMPRESSED: list[tuple[Kind, str]] = [
    *(("bag", "bz2"), ("bag", "lz4"), ("mcap", "storage"), ("mcap", "file"), ("mcap", "message")),
    *(("db3", "message"), ("db3", "file")),
]


@pytest.mark.parametrize(("kind", "compression"), COMPRESSED)
def test_compressed_bags_are_read(kind: Kind, compression: str, tmp_path: Path) -> None:
    path = _of_compression(tmp_path / ("a.bag" if kind == "bag" else "a"), kind, compression)
    with open_bag([path]) as bag:
        images = [image_of(bag.decode(each), "image") for each in bag.messages(["/image"])]
        assert [(image.shape, int(image.max()), int(image.min())) for image in images] == [
            ((600, 800, 3), n, n) for n in range(3)
        ]


@pytest.mark.parametrize(("kind", "compression"), COMPRESSED)
def test_a_bag_that_unpacks_to_too_much_is_refused(
    kind: Kind, compression: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("UNPACKED_FREELY", "UNPACKED_FREELY_TO_DISK"):
        monkeypatch.setattr(f"calibration.robot.importing.bags.bag.{name}", 1 << 16)
    monkeypatch.setattr("calibration.robot.importing.bags.bag.MAX_RATIO", 2)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    path = _of_compression(tmp_path / ("a.bag" if kind == "bag" else "a"), kind, compression)
    with (
        pytest.raises(InputError, match=r"/a(\.bag)?: this bag cannot be read: it unpacks to more than"),
        open_bag([path]) as bag,
    ):
        list(bag.messages(["/image"]))
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_budget_is_for_one_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.robot.importing.bags.bag.UNPACKED_FREELY", 5_000_000)
    monkeypatch.setattr("calibration.robot.importing.bags.bag.MAX_RATIO", 0)
    with open_bag([_of_compression(tmp_path / "a.bag", "bag", "bz2")]) as bag:
        for _ in range(5):
            assert len(list(bag.messages(["/image"]))) == 3


def test_a_chunk_that_is_cut_is_no_shorter_chunk(tmp_path: Path) -> None:
    packed = bz2.compress(bytes(1000))
    assert UnpackingBudget().unpack(bz2.BZ2Decompressor, packed + packed) == bytes(2000)
    with pytest.raises(UnpackingError, match="truncated"):
        UnpackingBudget().unpack(bz2.BZ2Decompressor, packed[:-4])


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize(
    "mode", ["compression_mode: FILE", '"compression\\x5fmode": FILE', "compression_mode: !!str file"]
)
def test_a_file_of_zstd_fills_no_disk_and_leaves_nothing(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    path = _of_compression(tmp_path / "a", "db3", "file")
    (file,) = path.glob("*.zstd")
    packed = zstd.ZstdCompressor()
    file.write_bytes(b"".join([packed.compress(ZEROS) for _ in range(100)] + [packed.flush()]))
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("compression_mode: file", mode))
    assert mode in metadata.read_text()
    with pytest.raises(InputError, match="a: this bag cannot be read"), open_bag([path]):
        pass
    assert list((tmp_path / "temporary").iterdir()) == []


def test_a_signal_leaves_no_unpacked_files(tmp_path: Path) -> None:
    path = _of_compression(tmp_path / "a", "db3", "file")
    (tmp_path / "tmp").mkdir()
    code = """
import sys, time
from pathlib import Path
from calibration.robot.importing.bags.bag import open_bag
from calibration.base.process import terminate_cleanly
with terminate_cleanly(), open_bag([Path(sys.argv[1])]):
    print("open", flush=True)
    time.sleep(60)
"""
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(path)],
        env={**os.environ, "TMPDIR": str(tmp_path / "tmp")},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"open\n"
    assert list((tmp_path / "tmp").iterdir())
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30)
    assert list((tmp_path / "tmp").iterdir()) == []


def test_a_named_pipe_in_a_bag_is_not_waited_for(tmp_path: Path) -> None:
    path = _of_compression(tmp_path / "a", "db3", "message")
    (file,) = path.glob("*.db3")
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(InputError, match=r"a\.db3: this is no regular file"), open_bag([path]):
        pass


def test_a_value_of_sqlite_is_no_longer_than_a_chunk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.robot.importing.bags.bag.MAX_CHUNK", 1 << 20)
    path = tmp_path / "a"
    with BagFile(path, "db3") as bag:
        bag.image("/image", BEGIN, np.zeros((600, 800, 3), np.uint8), "left")
    with pytest.raises(InputError, match="too big"), open_bag([path]) as opened:
        list(opened.messages(["/image"]))
