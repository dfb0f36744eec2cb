"""Episodes of a LeRobot dataset (v2.0, v2.1: one file an episode; v3.0: one of many), or of DROID's folders.

Paths are those of the format's version; the templates in ``meta/info.json`` must say the same, and are not evaluated.
Frames of a video are sought by their times: a file of many episodes is never decoded whole.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.base import InputError, parse_json_of, read_bytes, read_json
from calibration.base.arrays import Array
from calibration.base.optional import optional
from calibration.robot.importing.files.confined_decoding import FRAME_HEADER, confined_decoding
from calibration.robot.importing.videos import MAX_FRAME_PIXELS
from calibration.robot.labelling.detection import Image, grey

MAX_META_BYTES = 64_000_000
"""Limit of the size of a file of metadata."""
MAX_ROWS = 5_000_000
"""Limit of the frames of a file of parquet."""
MAX_TABLE_BYTES = 256_000_000
"""Limit of the size of its columns that are read, as text."""
MAX_EPISODES = 1_000_000
INFO = Path("meta", "info.json")
VERSIONS = {
    "v2.0": ("data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
             "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"),
    "v3.0": ("data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
             "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"),
}  # fmt: skip
"""Templates of the paths of data and videos, by version."""
VERSIONS["v2.1"] = VERSIONS["v2.0"]
DROID_VIDEOS = "recordings/MP4/*.mp4"


@dataclass(frozen=True)
class SoughtFrame:
    """Frame of a video."""

    time: float
    """s, in the video."""
    seconds: float
    """Length of the video."""
    image: Image
    """(H, W), grey."""


def frames_at(path: Path, times: Sequence[float]) -> Iterator[SoughtFrame]:
    """Yield the frames that are shown at some times, s, rising.

    Raises:
        InputError: it is no video, or damaged.
        InfrastructureError: PyAV is not installed.
    """
    optional("av", "episodes of videos")
    if not path.is_file():
        raise InputError(f"{path}: found no such file, expected a video of the dataset")
    request = {"times": list(times), "pixels": MAX_FRAME_PIXELS}
    with confined_decoding("sought-video", path, "a video", **request) as decoded:
        while len(head := decoded.read(FRAME_HEADER.size)) == FRAME_HEADER.size:
            _, time, seconds, width, height, _ = FRAME_HEADER.unpack(head)
            if not 0 < width * height <= MAX_FRAME_PIXELS:
                raise InputError(f"{path}: found frames of {width} x {height} pixels")
            data = decoded.read(3 * width * height)
            if len(data) < 3 * width * height:
                return
            yield SoughtFrame(time, seconds, grey(np.frombuffer(data, np.uint8).reshape(height, width, 3)))


@dataclass(frozen=True)
class EpisodeVideo:
    """Part of a video file that is one camera's of an episode."""

    path: Path
    begin: float
    """s, in the file."""
    seconds: float
    """From the first frame to the last."""


@dataclass(frozen=True)
class Episode:
    """Episode of a dataset."""

    name: str
    index: int
    videos: Mapping[str, EpisodeVideo]
    """By the name of the camera: the key of the feature, such as observation.images.wrist."""
    data: Path | None = None
    """File of its rows."""

    def column(self, name: str) -> tuple[Array, Array]:
        """Return the times (n,), s, and the values (n, k) of a column of its rows.

        Raises:
            InputError: the file cannot be read, or has no such column of numbers.
            InfrastructureError: pyarrow is not installed.
        """
        if self.data is None:
            raise InputError(f"{self.name}: found no file of rows, expected '{name}'")
        rows = read_parquet(self.data, ("episode_index", "timestamp", name))
        own = [i for i, index in enumerate(rows["episode_index"]) if index == self.index]
        try:
            times = np.array([rows["timestamp"][i] for i in own], float)
            values = np.array([rows[name][i] for i in own], float).reshape(len(own), -1)
        except (TypeError, ValueError):
            raise InputError(f"{self.data}: {name}: found no numbers, expected as many in each row") from None
        if not len(own) or not np.isfinite(values).all() or not np.isfinite(times).all():
            raise InputError(f"{self.data}: {name}: found no finite numbers of {self.name}")
        return times, values


def is_dataset(folder: Path) -> bool:
    """Whether a folder is a LeRobot dataset, or has episodes as DROID's."""
    return (folder / INFO).is_file() or next(_droid_folders(folder), None) is not None


def episodes_of(folder: Path, most: int) -> list[Episode]:
    """Return episodes of a dataset, evenly chosen if there are more.

    Raises:
        InputError: a file of metadata is wrong, or there is no episode with a video.
        InfrastructureError: pyarrow is not installed.
    """
    if not (folder / INFO).is_file():
        found = [_droid_episode(folder, each, i) for i, each in enumerate(sorted(_droid_folders(folder)))]
    else:
        info = _mapping(folder / INFO)
        version = info.get("codebase_version")
        if version not in VERSIONS:
            raise InputError(
                f"{folder / INFO}: codebase_version: found {version!r}, expected one of {', '.join(sorted(VERSIONS))}"
            )
        for key, expected in zip(("data_path", "video_path"), VERSIONS[version], strict=True):
            if info.get(key) not in (expected, None):
                raise InputError(f"{folder / INFO}: {key}: found {info[key]!r}, expected '{expected}'")
        features = info.get("features")
        cameras = [
            key for key, each in (features.items() if isinstance(features, dict) else ())
            if isinstance(each, dict) and each.get("dtype") == "video" and _is_plain_name(key)
        ]  # fmt: skip
        if not cameras:
            raise InputError(f"{folder / INFO}: features: found no camera with videos, expected dtype: video")
        rate = _number(info.get("fps"), folder / INFO, "fps", 1e-3, 1e4)
        found = list((_episodes_v3 if version == "v3.0" else _episodes_v2)(folder, info, cameras, rate))
    found = [each for each in found if each.videos]
    if not found:
        raise InputError(f"{folder}: found no episode with a video")
    chosen = np.unique(np.linspace(0, len(found) - 1, min(most, len(found))).round().astype(int))
    return [found[i] for i in chosen.tolist()]


def read_parquet(path: Path, columns: Sequence[str]) -> dict[str, list[Any]]:
    """Return columns of a file of parquet.

    Raises:
        InputError: it cannot be read, or lacks one, or has too many rows.
        InfrastructureError: pyarrow is not installed.
    """
    optional("pyarrow", "a LeRobot dataset")
    if not path.is_file():
        raise InputError(f"{path}: found no such file, expected rows of a dataset")
    with confined_decoding("parquet", path, "parquet", columns=list(columns), rows=MAX_ROWS) as decoded:
        content = decoded.read(MAX_TABLE_BYTES + 1)
    if len(content) > MAX_TABLE_BYTES:
        raise InputError(f"{path}: found more than {MAX_TABLE_BYTES} bytes of rows, expected fewer")
    table: dict[str, list[Any]] = json.loads(content)
    return table


def _episodes_v2(folder: Path, info: Mapping[str, Any], cameras: Sequence[str], rate: float) -> Iterator[Episode]:
    path = folder / "meta" / "episodes.jsonl"
    lines = read_bytes(path, MAX_META_BYTES, "the episodes").splitlines()
    size = int(_number(info.get("chunks_size", 1000), folder / INFO, "chunks_size", 1, 1e9))
    data, video = VERSIONS["v2.1"]
    for number, line in enumerate(filter(None, lines), 1):
        row = parse_json_of(line, f"{path}:{number}", "an episode")
        row = row if isinstance(row, dict) else {}
        index = int(_number(row.get("episode_index"), path, f"{number}: episode_index", 0, MAX_EPISODES))
        seconds = (_number(row.get("length"), path, f"{number}: length", 1, MAX_ROWS) - 1) / rate
        place = {"episode_chunk": index // size, "episode_index": index}
        videos = {key: EpisodeVideo(folder / video.format(video_key=key, **place), 0.0, seconds) for key in cameras}
        yield Episode(_name_of_episode(index), index, videos, folder / data.format(**place))


def _episodes_v3(folder: Path, info: Mapping[str, Any], cameras: Sequence[str], rate: float) -> Iterator[Episode]:
    paths = sorted((folder / "meta" / "episodes").glob("chunk-*/file-*.parquet"))
    if not paths:
        raise InputError(f"{folder / 'meta' / 'episodes'}: found no file, expected chunk-000/file-000.parquet")
    of_video = ("chunk_index", "file_index", "from_timestamp", "to_timestamp")
    columns = [f"videos/{key}/{each}" for key in cameras for each in of_video]
    data, video = VERSIONS["v3.0"]
    for path in paths:
        rows = read_parquet(path, ("episode_index", "data/chunk_index", "data/file_index", *columns))
        for i in range(len(rows["episode_index"])):
            at = {key: _number(each[i], path, f"row {i}: {key}", 0, 1e9) for key, each in rows.items()}
            videos = {}
            for key in cameras:
                chunk, file, begin, end = (at[f"videos/{key}/{each}"] for each in of_video)
                name = video.format(video_key=key, chunk_index=int(chunk), file_index=int(file))
                videos[key] = EpisodeVideo(folder / name, begin, max(end - begin - 1 / rate, 0.0))
            index = int(at["episode_index"])
            place = {"chunk_index": int(at["data/chunk_index"]), "file_index": int(at["data/file_index"])}
            yield Episode(_name_of_episode(index), index, videos, folder / data.format(**place))


def _droid_folders(folder: Path) -> Iterator[Path]:
    """Return the folders of episodes: one level or two (laboratory/success/episode) below."""
    for depth in ("", "*/", "*/*/", "*/*/*/"):
        yield from dict.fromkeys(path.parents[2] for path in folder.glob(depth + DROID_VIDEOS))


def _droid_episode(root: Path, folder: Path, index: int) -> Episode:
    """Return an episode of DROID, with its cameras by serial number; that of the wrist moves, and is left out."""
    wrist = ""
    for path in sorted(folder.glob("metadata*.json"))[:1]:
        wrist = str(_mapping(path).get("wrist_cam_serial", ""))
    videos = {
        path.stem: EpisodeVideo(path, 0.0, math.inf)
        for path in sorted(folder.glob(DROID_VIDEOS))
        if path.stem != wrist and not path.stem.endswith("-stereo")
    }
    return Episode(str(folder.relative_to(root)) or folder.name, index, videos)


def _mapping(path: Path) -> dict[str, Any]:
    found = read_json(path, MAX_META_BYTES, "metadata")
    if not isinstance(found, dict):
        raise InputError(f"{path}: found {type(found).__name__}, expected a mapping")
    return found


def _number(found: Any, path: Path, key: str, least: float, most: float) -> float:
    if isinstance(found, bool) or not isinstance(found, int | float) or not least <= found <= most:
        raise InputError(f"{path}: {key}: found {found!r:.80}, expected a number from {least:g} to {most:g}")
    return float(found)


def _is_plain_name(key: str) -> bool:
    return key not in ("", ".", "..") and not set(key) & set("/\\\0{}")


def _name_of_episode(index: int) -> str:
    return f"episode {index:06d}"
