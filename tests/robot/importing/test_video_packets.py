"""Video in bags: packets of H.264 and H.265, decoded from the key frame before them; by PyAV too where it is."""

import sys
from collections.abc import Sequence
from fractions import Fraction
from importlib import import_module
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg

from calibration.base import InputError
from calibration.robot.importing.bags.bag import VIDEO_TYPES, open_bag
from calibration.robot.importing.bags.survey import NO_KEY_FRAME_YET
from calibration.robot.importing.bags.video_packets import COMPRESSED_IMAGE, ImageReader, KeyFrames
from calibration.robot.importing.importing import import_data
from calibration.robot.importing.look.looking import look
from calibration.robot.importing.results import ImportResults
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind
from tests.robot.importing.test_bags import describe, file_of, image, refusal

FFMPEG, FOXGLOVE = VIDEO_TYPES
TOPIC = "/left/image_raw/video"
POSES, STAY, KEYS = 8, 3, 7
"""Poses of the pattern, images of each, and the distance of key frames."""
SAME = 4.0
"""Limit of the mean difference of an image and what a codec makes of it; of two poses it is more than twice as much."""
FRAMES = range(POSES * STAY)
KEY, OTHER = b"\0\0\0\x01\x67\0\0\0\x01\x65", b"\0\0\0\x01\x41"
"""Headers of NAL units: SPS and IDR, and a picture that needs others."""
DECODERS = ["stand-in", *(["PyAV"] if find_spec("av") else [])]


def shown(index: int) -> Any:
    return image("left_camera", index // STAY)


def difference(one: Any, other: Any) -> float:
    return float(cv2.absdiff(one, other).mean())


class DecodingError(ValueError):
    """What PyAV raises."""


class Capture:
    """What FFmpeg prints in a block."""

    now: "Capture"

    def __enter__(self) -> list[tuple[int, str, str]]:
        Capture.now, self.lines = self, list[tuple[int, str, str]]()
        return self.lines

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        return


class Frame:
    """Decoded frame."""

    def __init__(self, pixels: Any) -> None:
        self.pixels = pixels
        self.height, self.width = pixels.shape[:2]

    def to_ndarray(self, format: str) -> Any:  # noqa: A002
        assert format == "bgr24"
        return self.pixels


class Context:
    """Decoder of packets of a header, a number and a PNG, which needs all since the last key frame, as a video's."""

    def __init__(self, codec: str) -> None:
        self.options: dict[str, str] = {}
        self.codec, self.last = codec, -1

    @classmethod
    def create(cls, codec: str, mode: str) -> "Context":
        assert mode == "r"
        return cls(codec)

    def decode(self, packet: bytes) -> list[Frame]:
        header = KEY if packet.startswith(KEY) else OTHER
        number, content = packet[len(header)], packet[len(header) + 1 :]
        if header == OTHER and number != self.last + 1:
            Capture.now.lines.append((48, "h264", "Frame num gap 4 2\n"))
        self.last = number
        if content == b"two":
            return [Frame(shown(0))] * 2
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        if pixels is None:
            raise DecodingError("Invalid data found")
        return [Frame(pixels)]


def stand_in() -> ModuleType:
    """A module like PyAV."""
    module = ModuleType("av")
    module.__spec__ = ModuleSpec("av", None)
    logging, error = ModuleType("logging"), ModuleType("error")
    logging.__dict__.update(DEBUG=48, set_level=lambda _: None, set_skip_repeated=lambda _: None, Capture=Capture)
    error.__dict__.update(FFmpegError=DecodingError)
    module.__dict__.update(CodecContext=Context, Packet=bytes, logging=logging, error=error)
    return module


def packet(index: int) -> bytes:
    content = cv2.imencode(".png", shown(index))[1].tobytes()
    return (OTHER if index % KEYS else KEY) + bytes([index]) + content


def encoded_by_pyav(codec: str) -> list[bytes]:
    av = import_module("av")
    context = av.CodecContext.create({"h264": "libx264", "h265": "libx265"}[codec], "w")
    context.width, context.height, context.pix_fmt, context.time_base = 640, 480, "yuv420p", Fraction(1, 30)
    context.gop_size, context.max_b_frames = KEYS, 0
    context.options = {"preset": "ultrafast", "crf": "10", "tune": "zerolatency", "x265-params": "log-level=none"}
    packets = []
    for i in FRAMES:
        frame = av.VideoFrame.from_ndarray(shown(i), format="bgr24")
        frame.pts = i
        packets += context.encode(frame)
    return [bytes(each) for each in (*packets, *context.encode(None))]


@pytest.fixture
def stand_in_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", stand_in())


def packets_of(decoder: str, codec: str, monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    if decoder == "PyAV":
        return encoded_by_pyav(codec)
    monkeypatch.setitem(sys.modules, "av", stand_in())
    return [packet(i) for i in FRAMES]


def record_video(
    folder: Path,
    packets: Sequence[bytes],
    kind: Kind = "mcap",
    message: str = FFMPEG,
    codec: str = "h264",
    late: int = 0,
) -> Path:
    """A bag of a camera's packets, ten a second, the first of them ``late``."""
    path = file_of(folder, kind)
    with BagFile(path, kind) as bag:
        for name, definition in VIDEO_TYPES.items():
            bag.types.register(get_types_from_msg(definition, name))
        for i, content in enumerate(packets, late):
            stamp = BEGIN + i * SECOND // 10
            data = np.frombuffer(content, np.uint8)
            header = bag.header("left", stamp)
            if message == FFMPEG:
                size = {"width": 640, "height": 480, "pts": i, "flags": 0, "is_bigendian": False}
                made = bag.make(message, header=header, encoding=f"lib{codec};yuv420p;bgr8", data=data, **size)
            elif message == FOXGLOVE:
                made = bag.make(message, timestamp=header.stamp, frame_id="left", format=codec, data=data)
            else:
                made = bag.make(message, header=header, format=codec, data=data)
            bag.write(TOPIC, stamp, made)
    return path


def imported(path: Path) -> ImportResults:
    return import_data(describe(path, bags={"every": 0.1}), path.parent / "out", jobs=1)


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("decoder", DECODERS)
@pytest.mark.parametrize(
    ("kind", "message", "codec"),
    [("mcap", FFMPEG, "h264"), ("bag", FOXGLOVE, "h264"), ("db3", FOXGLOVE, "h264"), ("bag", COMPRESSED_IMAGE, "h264")],
)
def test_video_is_imported_as_images_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, decoder: str, kind: Kind, message: str, codec: str
) -> None:
    """Two packets at the begin need a key frame that was not recorded; one task begins between two key frames."""
    packets = packets_of(decoder, codec, monkeypatch)[KEYS - 2 :]
    results = imported(record_video(tmp_path, packets, kind, message, codec, KEYS - 2))
    assert [(each.rule, each.count) for each in results.left_out if each.place == "left"] == [(NO_KEY_FRAME_YET, 2)]
    assert results.left_out[0].first_s == pytest.approx(BEGIN / SECOND + (KEYS - 2) / 10)
    assert results.collections == len(packets) - 2
    files = sorted((tmp_path / "out").rglob("left*.png"))
    assert len(files) == len(packets) - 2
    for index, file in enumerate(files, KEYS):
        assert difference(np.asarray(cv2.imread(str(file))), shown(index)) < SAME


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("decoder", DECODERS)
@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_an_image_of_a_video_does_not_depend_on_what_was_read_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, decoder: str, codec: str
) -> None:
    if decoder == "stand-in" and codec == "h265":
        monkeypatch.setattr(sys.modules[__name__], "KEY", b"\0\0\x01\x42\0\0\x01\x26")
        monkeypatch.setattr(sys.modules[__name__], "OTHER", b"\0\0\x01\x02")
    path = record_video(tmp_path, packets_of(decoder, codec, monkeypatch), codec=codec)
    with open_bag([path]) as bag:
        found = KeyFrames(bag)
        messages = list(bag.messages({TOPIC}))
        assert all(found.add(message) for message in messages)
        assert found.recorded == {TOPIC: [message.recorded for message in messages[::KEYS]]}
        reader = ImageReader(bag, found.recorded)
        for index in (3, 4, 9, 8, 8, 20, 6, 7, 0, 13):
            time = messages[index].recorded
            ((message, decode),) = reader.images({TOPIC}, time, time + 1)
            assert message.recorded == time
            assert difference(decode(), shown(index)) < SAME


@pytest.mark.parametrize("decoder", DECODERS)
def test_a_lost_packet_is_an_error_with_its_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, decoder: str) -> None:
    packets = packets_of(decoder, "h264", monkeypatch)
    error = refusal(describe(record_video(tmp_path, [*packets[:3], *packets[4:]])))
    assert f"{TOPIC} at {BEGIN // SECOND}.300" in error
    assert "was a packet before it lost?" in error


@pytest.mark.parametrize("decoder", DECODERS)
def test_damaged_packets_end_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, decoder: str) -> None:
    packets = packets_of(decoder, "h264", monkeypatch)
    random = np.random.default_rng(0)
    for number, index in enumerate((0, 1, 3, 5, KEYS)):
        for edit in (
            lambda data: data[: len(data) // 2],
            lambda _: b"",
            lambda data: data[:12] + random.bytes(len(data) - 12),
            lambda data: data[:40] + bytes(each ^ 0x55 for each in data[40:60]) + data[60:],
        ):
            folder = tmp_path / f"{number}-{len(list(tmp_path.iterdir()))}"
            folder.mkdir()
            damaged = [edit(each) if i == index else each for i, each in enumerate(packets[:9])]
            path = record_video(folder, damaged)
            with open_bag([path]) as bag:
                found = KeyFrames(bag)
                for message in bag.messages({TOPIC}):
                    found.add(message)
                try:
                    for _, decode in ImageReader(bag, found.recorded).images({TOPIC}, BEGIN, BEGIN + SECOND):
                        assert decode().shape == (480, 640, 3)
                except InputError as error:
                    assert f"{TOPIC}" in str(error)  # noqa: PT017
                    assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.usefixtures("stand_in_decoder")
@pytest.mark.parametrize(
    ("packets", "message"),
    [
        ([KEY + b"\0two"], "gives 2 frames at once"),
        ([KEY + b"\0junk"], "Invalid data found"),
        ([packet(0), b""], "found a packet of 0 bytes"),
        ([OTHER + b"\0junk"], "found no key frame"),
    ],
)
def test_a_video_that_cannot_be_decoded(tmp_path: Path, packets: list[bytes], message: str) -> None:
    error = refusal(describe(record_video(tmp_path, packets)))
    assert TOPIC in error
    assert message in error
    assert "record Image or" in error or message == "found a packet of 0 bytes"


@pytest.mark.usefixtures("stand_in_decoder")
def test_a_frame_of_too_many_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calibration.robot.importing.bags.video_packets.MAX_VIDEO_PIXELS", 640 * 480 - 1)
    assert "640 x 480 pixels" in refusal(describe(record_video(tmp_path, [packet(0)])))


@pytest.mark.usefixtures("stand_in_decoder")
def test_of_images_and_their_video_the_images_are_read(tmp_path: Path) -> None:
    path = record_video(tmp_path, [packet(i) for i in FRAMES])
    with BagFile(tmp_path / "more", "mcap") as bag:
        for i in range(POSES):
            bag.image("/left/image_raw/compressed", BEGIN + i * SECOND, image("left_camera", i), "left", "jpeg")
    config = describe(path, bags={"files": ["more", path.name]})
    assert import_data(config, tmp_path / "out", jobs=1).collections == POSES


@pytest.mark.parametrize("decoder", DECODERS)
def test_look_decodes_video(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, decoder: str) -> None:
    packets = packets_of(decoder, "h264", monkeypatch)[2:]
    (camera,) = look(record_video(tmp_path, packets, message=FOXGLOVE, late=2)).cameras.values()
    assert camera.fault == ""
    assert (camera.width, camera.height) == (640, 480)
    assert camera.looked_at == len(FRAMES) - KEYS
