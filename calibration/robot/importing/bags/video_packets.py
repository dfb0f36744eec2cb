"""Video in a bag, a packet of H.264 or H.265 in each message, decoded by PyAV where it is installed."""

import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from calibration.base import InputError
from calibration.base.optional import optional
from calibration.robot.importing.bags.bag import VIDEO_TYPES, Bag, RawMessage
from calibration.robot.importing.bags.messages import NO_VIDEO, image_of
from calibration.robot.labelling.detection import Image

COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
MAX_VIDEO_PIXELS = 8192 * 4320
"""Limit of a frame's pixels: a decoder may hold 16 frames, 0.9 GB."""
MAX_PACKET_BYTES = 1 << 26
"""Limit of a packet: no frame of 8K takes as much."""
NO_KEY_FRAME = f"found no key frame of H.264 or H.265 with its parameters (SPS), expected one every second: {NO_VIDEO}"
_CODEC_OF_NAME = {"264": "h264", "265": "hevc", "hevc": "hevc"}
"""FFmpeg's names of the codecs by a part of what the messages say ("libx264", "hevc_nvenc;nv12;bgr8")."""
_START_HEADERS = {
    "h264": (re.compile(rb"\0\0\x01[\x07\x27\x47\x67]"), re.compile(rb"\0\0\x01[\x05\x25\x45\x65]")),
    "hevc": (re.compile(rb"\0\0\x01[\x42\x43]"), re.compile(rb"\0\0\x01[\x20-\x2b]")),
}
"""Headers of NAL units in a packet with which decoding begins: an SPS, and a picture that needs no other (H.264 7.3.1,
types 7 and 5; H.265 7.3.1.2, types 33 and 16 to 21)."""
_LOST_PACKET = re.compile("frame num gap|conceal|missing (picture|reference)", re.IGNORECASE)
"""In what FFmpeg logs where it makes up what a lost packet held: the frame that it returns is not marked."""


def is_pyav_installed() -> bool:
    """Return whether video in bags can be decoded."""
    return find_spec("av") is not None


def codec_of(message: Any) -> str | None:
    """Return FFmpeg's name of the codec of a message with video; None if it is an image, or of another codec."""
    words = str(getattr(message, "encoding", None) or getattr(message, "format", "")).lower().partition(";")[0]
    return next((codec for part, codec in _CODEC_OF_NAME.items() if part in words), None)


def is_key_frame(message: Any) -> bool:
    """Return whether decoding can begin with a message."""
    codec = codec_of(message)
    return codec is not None and all(header.search(message.data.tobytes()) for header in _START_HEADERS[codec])


class KeyFrames:
    """Where the videos among the topics of a bag can be decoded from, as their messages are read in order."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self._is_video: dict[str, bool] = {}
        self.recorded: dict[str, list[int]] = {}
        """Recording times of the key frames of each topic with video, ns, in ascending order."""

    def add(self, message: RawMessage) -> bool:
        """Add a message of any topic; return whether it can be decoded: not if it is before the first key frame.

        Raises:
            InputError: it is invalid or truncated.
        """
        topic = message.topic
        kind = self._bag.topics[topic]
        if self._is_video.get(topic) is False or kind not in (COMPRESSED_IMAGE, *VIDEO_TYPES):
            return True
        content = self._bag.decode(message)
        if topic not in self._is_video:
            self._is_video[topic] = is_pyav_installed() and (kind in VIDEO_TYPES or codec_of(content) is not None)
            if not self._is_video[topic]:
                return True
        found = self.recorded.setdefault(topic, [])
        if is_key_frame(content):
            found.append(message.recorded)
        return bool(found)


class ImageReader:
    """Images of topics of a bag; those of a video are decoded from the key frame before them, or where it stopped."""

    def __init__(self, bag: Bag, key_frames: Mapping[str, Sequence[int]]) -> None:
        self._bag = bag
        self._key_frames = key_frames
        self._decoders: dict[str, tuple[_PacketDecoder, int]] = {}
        """Of topics with video: what has decoded all packets before a time, ns."""

    def images(
        self, topics: Collection[str], start: int, stop: int
    ) -> Iterator[tuple[RawMessage, Callable[[], Image]]]:
        """Iterate over the messages of some topics from ``start`` to before ``stop``, ns, with what decodes each.

        Raises:
            InputError: the bag is damaged, or a video has no key frame, or cannot be decoded.
        """
        decoders: dict[str, _PacketDecoder] = {}
        begins = dict.fromkeys(topics, start)
        for topic in self._key_frames.keys() & begins.keys():
            if not (keys := self._key_frames[topic]):
                raise InputError(f"{self._bag.path}: {topic}: {NO_KEY_FRAME}")
            key = keys[max(bisect_right(keys, start) - 1, 0)]
            decoder, begin = self._decoders.pop(topic, (_PacketDecoder(), key))
            goes_on = key <= begin <= start
            decoders[topic], begins[topic] = (decoder, begin) if goes_on else (_PacketDecoder(), key)
        for message in self._bag.messages(topics, min(begins.values()), stop):
            if message.recorded < begins[message.topic]:
                continue
            content = self._bag.decode(message)
            where = self._bag.place(message)
            image: Callable[[], Image] | None = partial(image_of, content, where)
            if message.topic in decoders:
                image = decoders[message.topic].decode(content, where)
            if image is not None and message.recorded >= start:
                yield message, image
        self._decoders |= {topic: (decoder, stop) for topic, decoder in decoders.items()}


class _PacketDecoder:
    """Decoder of a video that returns the frame of each packet at once, in one thread."""

    def __init__(self) -> None:
        self._context: Any = None
        self._codec = ""

    def decode(self, message: Any, where: str) -> Callable[[], Image] | None:
        """Decode a packet: return what converts its frame; None before the first key frame.

        Raises:
            InputError: it cannot be decoded, packets before it are lost, or frames are not in order.
        """
        av = optional("av", "video in a bag")
        codec, data = codec_of(message) or "", message.data.tobytes()
        if self._context is None:
            if not is_key_frame(message):
                return None
            self._codec, self._context = codec, av.CodecContext.create(codec, "r")
            limits = {"threads": "1", "max_pixels": str(MAX_VIDEO_PIXELS)}
            self._context.options = {"flags": "low_delay", "err_detect": "explode", **limits}
        if codec != self._codec or not 0 < len(data) <= MAX_PACKET_BYTES:
            raise InputError(
                f"{where}: found a packet of {len(data)} bytes of '{codec}', expected 1 to {MAX_PACKET_BYTES} of "
                f"'{self._codec}'"
            )
        av.logging.set_skip_repeated(False)
        av.logging.set_level(av.logging.DEBUG)  # of "Frame num gap"
        try:
            with av.logging.Capture() as log:
                frames = self._context.decode(av.Packet(data))
        except (av.error.FFmpegError, ValueError, MemoryError) as error:
            raise _decoding_error(where, " ".join(str(error).split())) from None
        finally:
            av.logging.set_level(None)
        if lost := [text for _, _, text in log if _LOST_PACKET.search(text)]:
            raise _decoding_error(where, " ".join(lost[0].split()))
        if len(frames) != 1:
            raise InputError(
                f"{where}: found a packet of a video that gives {len(frames)} frames at once, expected one, as without "
                f"B-frames: {NO_VIDEO}"
            )
        return partial(_frame_as_bgr, av, frames[0], where)


def _frame_as_bgr(av: Any, frame: Any, where: str) -> Image:
    """Convert a frame to (H, W, 3), 8 bits, BGR."""
    if not 0 < frame.width * frame.height <= MAX_VIDEO_PIXELS:
        raise InputError(
            f"{where}: found a frame of {frame.width} x {frame.height} pixels, expected {MAX_VIDEO_PIXELS} at most"
        )
    try:
        return np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)
    except (av.error.FFmpegError, ValueError, MemoryError) as error:
        raise _decoding_error(where, " ".join(str(error).split())) from None


def _decoding_error(where: str, why: str) -> InputError:
    return InputError(
        f"{where}: a frame of a video cannot be decoded: {why[:300]}; was a packet before it lost? Cut the bag there, "
        f"or {NO_VIDEO}"
    )
