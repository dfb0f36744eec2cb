"""Bags of ROS 1 and ROS 2, read without ROS by the library rosbags, and unpacked with a limit.

Messages are decoded by the library's own definitions, never by those in a bag, because the library generates
program code from definitions; `Bag.definitions` are a bag's, for a reader that generates none.
"""

import bz2
import errno
import heapq
import json
import os
import re
import struct
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from calibration.base import CalibrationError, InfrastructureError, InputError, read_bytes, read_yaml, temporary_folder
from calibration.base.optional import optional
from calibration.engine.dataset.document import Node

if TYPE_CHECKING:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.typesys.store import Typestore


MAX_CHUNK = 1 << 28
"""Limit of the bytes that one chunk, or one message, unpacks to."""
UNPACKED_FREELY = 1 << 26
"""Bytes that a bag may unpack to, however small it is: a few images of one colour, or depths without a return."""
UNPACKED_FREELY_TO_DISK = 1 << 28
"""The same of a file that is compressed as a whole: there it goes to the disk."""
MAX_RATIO = 250
"""Limit of unpacked bytes for each packed one, beyond these; recorded images have 2 to 10, rendered ones 100."""
_TOO_MUCH = f"it unpacks to more than {MAX_RATIO} times its size"
MAX_LZ4_RATIO = 255
"""Limit that lz4's format has itself."""


class UnpackingError(Exception):
    """Something unpacks to too much, or is truncated."""


class UnpackingBudget:
    """What may still be unpacked in one pass over a bag."""

    def __init__(self) -> None:
        self._left = UNPACKED_FREELY

    @property
    def room(self) -> int:
        """Limit of the next chunk."""
        return min(self._left, MAX_CHUNK)

    def unpack(self, decompressor: Callable[[], Any], packed: bytes) -> bytes:
        """Unpack a chunk.

        Args:
            decompressor: class of bz2, lz4 or zstd that unpacks one stream up to a length.
            packed: the chunk: one stream, or several in succession.

        Raises:
            UnpackingError: it unpacks to more than is left, or is truncated.
        """
        self._left += MAX_RATIO * len(packed)
        parts = []
        rest: bytes | None = packed
        while rest:
            stream, room = decompressor(), self.room
            parts.append(stream.decompress(rest, max_length=room + 1))
            self._spend_bytes(len(parts[-1]))
            if len(parts[-1]) > room:
                raise UnpackingError(f"found a chunk that unpacks to more than {MAX_CHUNK} bytes")
            if not stream.eof:
                raise UnpackingError("found a chunk that is truncated")
            rest = stream.unused_data
        return b"".join(parts)

    def unpack_lz4(self, packed: bytes) -> bytes:
        """Unpack a chunk of lz4, as `unpack` does; at once, where no more than there is room for can come out of it.

        Raises:
            UnpackingError: it unpacks to more than is left, or is truncated.
        """
        lz4 = optional("lz4.frame", "reading bags")
        if MAX_LZ4_RATIO * len(packed) > self.room:
            return self.unpack(lz4.LZ4FrameDecompressor, packed)
        self._left += MAX_RATIO * len(packed)
        found: bytes = lz4.decompress(packed)
        self._spend_bytes(len(found))
        return found

    def _spend_bytes(self, size: int) -> None:
        self._left -= size
        if self._left < 0:
            raise UnpackingError(_TOO_MUCH)


def unpack_files(files: Sequence[Path], folder: Path) -> list[Path]:
    """Unpack files of zstd into a folder, and return theirs, whose names lack the last suffix.

    Raises:
        UnpackingError: they unpack to more than they may.
        OSError, zstd.ZstdError: one cannot be read or written, or is damaged.
    """
    zstd = optional("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd", "reading bags")
    left = UNPACKED_FREELY_TO_DISK + MAX_RATIO * sum(file.stat().st_size for file in files)
    unpacked = [folder / file.stem for file in files]
    for file, target in zip(files, unpacked, strict=True):
        with file.open("rb") as packed, zstd.open(packed, "rb") as source, target.open("xb") as output:
            while part := source.read(1 << 20):
                left -= len(part)
                if left < 0:
                    raise UnpackingError(_TOO_MUCH)
                output.write(part)
    return unpacked


_budget = UnpackingBudget()


def begin_pass() -> None:
    """Begin a pass over a bag: what the library unpacks in it is counted anew."""
    global _budget
    _budget = UnpackingBudget()


def bound_library() -> None:
    """Replace the functions by which the library unpacks chunks and messages."""
    reader1, reader2, mcap = (
        optional(f"rosbags.{name}", "reading bags")
        for name in ("rosbag1.reader", "rosbag2.reader", "rosbag2.storage_mcap")
    )
    if isinstance(reader2.zstd, SimpleNamespace):
        return  # it is done

    def unpack_zstd(packed: bytes, _size: int = 0, decompressor: Any = reader2.zstd.ZstdDecompressor) -> bytes:
        return _budget.unpack(decompressor, packed)

    reader1.decompressors["bz2"] = lambda packed: _budget.unpack(bz2.BZ2Decompressor, packed)
    reader1.decompressors["lz4"] = lambda packed: _budget.unpack_lz4(packed)
    mcap.DECOMPRESSORS |= {"lz4": lambda packed, _: _budget.unpack_lz4(packed), "zstd": unpack_zstd}
    reader2.zstd = SimpleNamespace(decompress=unpack_zstd)  # without open: `unpack_files` is there for whole files


BAG_ENDINGS = (".bag", ".db3", ".mcap")
"""Endings of single files; a ROS 2 folder has a metadata.yaml."""
NS_PER_S = 10**9
MAX_METADATA_BYTES = 1 << 22
"""Limit of the size of a metadata.yaml."""
MAX_DEFINITION_CHARACTERS = 1 << 18
"""Limit of the definition of a type of messages."""
_WHOLE_FILES = re.compile(rb"^[ '\"]*compression_mode['\"]?\s*:\s*['\"]?file\b", re.IGNORECASE | re.MULTILINE)
_SQLITE_LIMIT_LENGTH = 0
"""SQLite's number of the limit of a value's length (https://www.sqlite.org/c3ref/c_limit_attached.html)."""
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FOXGLOVE_VIDEO = "foxglove_msgs/msg/CompressedVideo"
VIDEO_TYPES = {
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": "std_msgs/Header header\nint32 width\nint32 height\n"
    "string encoding\nuint64 pts\nuint8 flags\nbool is_bigendian\nuint8[] data",
    FOXGLOVE_VIDEO: "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format",
}
"""Definitions of messages that hold a packet of a video; Foxglove's has no header, but begins with a stamp."""
_LIVOX_POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
_LIVOX_POINTS = {f"livox_ros_driver{version}/msg/CustomPoint": _LIVOX_POINT for version in ("", "2")}
LIVOX_TYPES = {
    kind.replace("Point", "Msg"): "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\n"
    "uint8[3] rsvd\nCustomPoint[] points"
    for kind in _LIVOX_POINTS
}
"""Definitions of the clouds of Livox's drivers."""
MORE_TYPES = (
    dict.fromkeys(TF_TYPES, "geometry_msgs/TransformStamped[] transforms") | VIDEO_TYPES | _LIVOX_POINTS | LIVOX_TYPES
)
"""Definitions of messages that the library lacks for some versions of ROS."""


@dataclass(frozen=True)
class RawMessage:
    """Undecoded message of a bag."""

    topic: str
    recorded: int
    """Recording time, ns."""
    data: bytes


@dataclass(frozen=True, eq=False)
class _Part:
    """File of a bag, or folder of ROS 2."""

    path: Path
    unpacked: Path
    """The path, or a temporary folder with the same if its files are compressed as a whole."""
    reader: "Reader1 | Reader2"


class Bag:
    """Open bag, of one file or of several consecutive ones; a forked process opens it once more, where it reads it."""

    def __init__(self, parts: Sequence[_Part], ros: int) -> None:
        self._parts = parts
        self._inherited: Sequence[_Part] = ()
        self._process = os.getpid()
        self.ros = ros
        """Version of ROS, 1 or 2."""

    @property
    def path(self) -> Path:
        """First file, for messages."""
        return self._parts[0].path

    @cached_property
    def topics(self) -> Mapping[str, str]:
        """Type of every topic, such as "sensor_msgs/msg/Image"."""
        found = {}
        for part in self._parts:
            with _as_input_error(part.path):
                found.update({each.topic: each.msgtype for each in part.reader.connections})
        if wrong := [each for pair in found.items() for each in pair if not isinstance(each, str)]:
            raise InputError(f"{self.path}: found {wrong[0]!r} as a topic or its type, expected a name: is it damaged?")
        return dict(sorted(found.items()))

    @property
    def span(self) -> tuple[int, int] | None:
        """Recording times of the first and the last message, ns; None of a bag without messages."""
        spans = []
        for part in self._parts:
            with _as_input_error(part.path):
                if part.reader.message_count:
                    spans.append((part.reader.start_time, part.reader.end_time - 1))  # the library's is after it
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    @property
    def callers(self) -> frozenset[str]:
        """Names of the nodes whose messages a bag of ROS 1 has; ROS 2 keeps none."""
        found = {getattr(each.ext, "callerid", None) for part in self._parts for each in part.reader.connections}
        return frozenset(name for name in found if name)

    def definitions(self, topic: str) -> Mapping[str, Any]:
        """Return the constants and fields of a topic's type and of those in it: the bag's own, else the library's.

        They are for reading fields by their bytes (never to be registered: see the module's page).

        Raises:
            InputError: a definition cannot be read, or the topic has several types.
        """
        library = typestore(self.ros).fielddefs
        given = {
            (each.msgtype, each.msgdef)
            for part in self._parts
            for each in part.reader.connections
            if each.topic == topic
        }
        if len({kind for kind, _ in given}) != 1:
            kinds = ", ".join(sorted({kind for kind, _ in given}))
            raise InputError(f"{self.path}: {topic}: found messages of {kinds}, expected one type")
        types = optional("rosbags.typesys", "reading bags")
        found = dict(library)
        for kind, definition in given:
            parse = {1: types.get_types_from_msg, 2: types.get_types_from_idl}.get(definition.format.value)
            if parse is None:
                continue
            if len(definition.data) > MAX_DEFINITION_CHARACTERS:
                raise InputError(
                    f"{self.path}: {topic}: found a definition of {len(definition.data)} characters, expected at most "
                    f"{MAX_DEFINITION_CHARACTERS}"
                )
            with _as_input_error(self.path, f"{topic}: the definition of {kind} cannot be read"):
                found |= parse(definition.data, kind) if parse is types.get_types_from_msg else parse(definition.data)
        return found

    def of_type(self, *types: str) -> list[str]:
        """Return the topics of some types, such as "sensor_msgs/msg/Image"."""
        return [topic for topic, kind in self.topics.items() if kind in types]

    def messages(
        self, topics: Collection[str], start: int | None = None, stop: int | None = None
    ) -> Iterator[RawMessage]:
        """Iterate over the messages of some topics in recording order; from ``start`` to before ``stop``, ns.

        Raises:
            InputError: the bag is damaged.
        """
        begin_pass()
        self._open_in_this_process()
        streams = [self._of_part(part, topics, start, stop) for part in self._parts]
        yield from streams[0] if len(streams) == 1 else heapq.merge(*streams, key=lambda message: message.recorded)

    def _open_in_this_process(self) -> None:
        """Open the files anew in a forked process: with those of its parent it would share the place in them."""
        if self._process != os.getpid():
            self._inherited = self._parts  # SQLite allows no other process to close them
            self._parts = [_opened_part(part.path, part.unpacked, self.ros) for part in self._parts]
            self._process = os.getpid()

    @staticmethod
    def _of_part(part: _Part, topics: Collection[str], start: int | None, stop: int | None) -> Iterator[RawMessage]:
        with _as_input_error(part.path):
            wanted = [each for each in part.reader.connections if each.topic in topics]
            if not wanted:
                return
            for connection, recorded, data in part.reader.messages(wanted, start, stop):
                yield RawMessage(connection.topic, recorded, bytes(data))

    def decode(self, message: RawMessage) -> Any:
        """Decode a message of one of ROS's own types.

        Raises:
            InputError: it is invalid or truncated.
        """
        kind = self.topics[message.topic]
        with _as_input_error(self.path, f"{message.topic}: a message of {kind} cannot be decoded"):
            if self.ros == 1:
                return typestore(self.ros).deserialize_ros1(message.data, kind)
            return typestore(self.ros).deserialize_cdr(message.data, kind)

    def stamp(self, message: RawMessage) -> int:
        """Return the time in a message's header, ns, without decoding the rest; the recording time if it is 0.

        Raises:
            InputError: it is truncated.
        """
        try:
            if self.ros == 1:
                begin = 0 if self.topics[message.topic] == FOXGLOVE_VIDEO else 4  # no number before it
                seconds, rest = struct.unpack_from("<II", message.data, begin)
            else:
                order = "<" if message.data[1] & 1 else ">"
                seconds, rest = struct.unpack_from(f"{order}iI", message.data, 4)
        except (struct.error, IndexError):
            raise InputError(f"{self.path}: {message.topic}: found a message of {len(message.data)} bytes") from None
        return seconds * NS_PER_S + rest or message.recorded

    def place(self, message: RawMessage) -> str:
        """Return the file, the topic and the stamp of a message, for messages of errors."""
        return f"{self.path}: {message.topic} at {self.stamp(message) / NS_PER_S:.3f}"

    def without_stamp(self, message: RawMessage) -> bytes:
        """Return the bytes of a message that begins with a header, without its number and stamp."""
        return message.data[12:]


@cache
def typestore(ros: int) -> "Typestore":
    """Return the definitions of messages of a version of ROS, once: its decoders are generated."""
    types = optional("rosbags.typesys", "reading bags")
    store: Typestore = types.get_typestore(types.Stores.ROS1_NOETIC if ros == 1 else types.Stores.ROS2_HUMBLE)
    for kind, definition in MORE_TYPES.items():
        if kind not in store.fielddefs:
            store.register(types.get_types_from_msg(definition, kind))
    return store


@contextmanager
def open_bag(paths: Sequence[Path]) -> Iterator[Bag]:
    """Open a bag for reading: consecutive files of ROS 1, or files or folders of ROS 2.

    Raises:
        InputError: a file does not exist, is not a bag, is damaged or encrypted, or files of both kinds are mixed.
        InfrastructureError: rosbags is not installed.
    """
    kinds = {_ros_of(path) for path in paths}
    if len(kinds) != 1:
        raise InputError(f"{paths[0]}: found bags of ROS 1 and of ROS 2, expected one kind")
    ros = kinds.pop()
    bound_library()
    begin_pass()
    with ExitStack() as stack:
        parts = []
        for path in paths:
            with _as_input_error(path):
                part = _opened_part(path, _folder_of_unpacked_bag(path, stack) if path.is_dir() else path, ros)
            stack.callback(part.reader.close)
            parts.append(part)
        yield Bag(parts, ros)


def _opened_part(path: Path, unpacked: Path, ros: int) -> _Part:
    with _as_input_error(path):
        reader = optional(f"rosbags.rosbag{ros}", "reading bags").Reader(unpacked)
        reader.open()
        _bound_messages(reader)
    return _Part(path, unpacked, reader)


def _folder_of_unpacked_bag(folder: Path, stack: ExitStack) -> Path:
    """Return the folder of a ROS 2 bag, or a temporary one with its files if they are compressed as a whole."""
    metadata = folder / "metadata.yaml"
    data = read_bytes(metadata, MAX_METADATA_BYTES, "a bag's metadata")
    if not _WHOLE_FILES.search(data):
        return folder
    bag = Node(metadata, (), read_yaml(metadata, "a bag's metadata"))["rosbag2_bagfile_information"]
    files = [folder / Path(each.text()).name for each in bag["relative_file_paths"].elements()]
    unpacked = stack.enter_context(temporary_folder(prefix="calibration-bag-"))
    names = [file.name for file in unpack_files(files, unpacked)]
    document = {**bag.mapping(), "compression_mode": "", "compression_format": "", "relative_file_paths": names}
    (unpacked / metadata.name).write_text(json.dumps({"rosbag2_bagfile_information": document}))
    return unpacked


def _bound_messages(reader: "Reader1 | Reader2") -> None:
    """Bound the size of a message of an SQLite database, which can claim more than the file has."""
    storage = getattr(reader, "storage", None)
    for each in getattr(storage, "storages", [storage]):
        if (database := getattr(each, "dbconn", None)) is not None:
            database.limit(_SQLITE_LIMIT_LENGTH, MAX_CHUNK)


def _ros_of(path: Path) -> int:
    """Return the version of ROS, 1 or 2."""
    if not path.exists():
        raise InputError(f"{path}: found no such file, expected a bag")
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            raise InputError(
                f"{path}: found no metadata.yaml in it, expected a ROS 2 bag, or a file {_supported_endings()}"
            )
        if strange := [each.name for each in path.iterdir() if not each.is_file() and not each.is_dir()]:
            raise InputError(f"{path / strange[0]}: this is no regular file, expected a file of a bag")
        return 2
    if path.suffix not in BAG_ENDINGS:
        raise InputError(f"{path}: expected a bag: a file {_supported_endings()}, or a folder with metadata.yaml")
    if not path.stat().st_size:
        raise InputError(f"{path}: this bag is empty: found 0 bytes")
    if not path.is_file():
        raise InputError(f"{path}: this is no regular file, a bag was expected")
    return 1 if path.suffix == ".bag" else 2


def _supported_endings() -> str:
    return f"that ends in {', '.join(BAG_ENDINGS)}"


@contextmanager
def _as_input_error(path: Path, what: str = "this bag cannot be read") -> Iterator[None]:
    """Convert any exception of the library to an InputError; MemoryError too, which damaged lengths cause."""
    try:
        yield
    except CalibrationError:
        raise
    except UnpackingError as error:
        raise InputError(f"{path}: {what}: {error}") from None
    except Exception as error:
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            raise InfrastructureError(f"{path}: there is no space to unpack it: {error.filename}") from error
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: {what}: {reason}; is it truncated, unindexed or encrypted?") from None
