"""Tiny datasets of the formats v2.1 and v3.0, and folders as DROID's, written by the libraries."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow as pa
from pyarrow import parquet

from calibration.base.arrays import Array
from calibration.robot.labelling.detection import Image

RATE = 5
SECONDS = 4
KEY = "observation.images.front"
COUNT = RATE * SECONDS


def wall(seed: int = 0) -> Image:
    """A textured wall (240, 320)."""
    random = np.random.default_rng(seed)
    image = cv2.resize(random.integers(0, 255, (40, 54), np.uint8), (360, 270), interpolation=cv2.INTER_CUBIC)
    for x, y in random.integers(20, 250, (60, 2)).tolist():
        cv2.circle(image, (x + 40, y), int(random.integers(3, 9)), int(random.integers(0, 255)), -1, cv2.LINE_AA)
    return np.asarray(image)


def frames(shift_px: float = 0.0, begin: int = 0) -> list[Image]:
    """An episode of a camera before a wall, which moves by so many pixels from a frame on."""
    random = np.random.default_rng(1)
    found = []
    for i in range(COUNT):
        at = np.array([[1.0, 0, -10 - shift_px * (i >= begin)], [0, 1, -10]])
        image = cv2.warpAffine(wall(), at, (320, 240)).astype(float) + random.normal(0, 2, (240, 320))
        found.append(np.clip(image, 0, 255).astype(np.uint8))
    return found


def write_video(path: Path, images: Sequence[Image]) -> None:
    """Write a video of grey images."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=RATE)
        stream.height, stream.width = images[0].shape
        stream.pix_fmt, stream.bit_rate, stream.gop_size = "yuv420p", 4_000_000, 2
        for image in images:
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="gray")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)


def write_rows(path: Path, columns: dict[str, Any]) -> None:
    """Write a file of parquet."""
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(pa.table(columns), path)


def write_dataset(
    folder: Path, version: str, episodes: Sequence[Sequence[Image]], poses: Array | None = None, key: str = KEY
) -> Path:
    """Write a dataset with one camera; poses (n, 6) of the hand are the column "hand" of each episode."""
    is_v3 = version == "v3.0"
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(info_of_dataset(version, len(episodes), key, episodes[0][0].shape))
    rows = [rows_of_episode(i, len(each), poses) for i, each in enumerate(episodes)]
    if is_v3:
        write_rows(
            folder / "data/chunk-000/file-000.parquet",
            {name: [value for each in rows for value in each[name]] for name in rows[0]},
        )
        write_video(folder / f"videos/{key}/chunk-000/file-000.mp4", [image for each in episodes for image in each])
        begins = np.cumsum([0, *(len(each) / RATE for each in episodes)])
        numbers = list(range(len(episodes)))
        zeros = [0] * len(episodes)
        place = {"data/chunk_index": zeros, "data/file_index": zeros}
        place |= {f"videos/{key}/{name}_index": zeros for name in ("chunk", "file")}
        times = {
            f"videos/{key}/from_timestamp": begins[:-1].tolist(),
            f"videos/{key}/to_timestamp": begins[1:].tolist(),
        }
        write_rows(folder / "meta/episodes/chunk-000/file-000.parquet", {"episode_index": numbers, **place, **times})
        return folder
    lines = [{"episode_index": i, "tasks": ["stack"], "length": len(each)} for i, each in enumerate(episodes)]
    (folder / "meta" / "episodes.jsonl").write_text("\n".join(map(json.dumps, lines)))
    for i, images in enumerate(episodes):
        write_rows(folder / f"data/chunk-000/episode_{i:06d}.parquet", rows[i])
        write_video(folder / f"videos/chunk-000/{key}/episode_{i:06d}.mp4", images)
    return folder


def info_of_dataset(version: str, episodes: int, key: str, shape: tuple[int, ...]) -> str:
    """The file meta/info.json."""
    data = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    video = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    if version != "v3.0":
        data = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
        video = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
    feature = {"dtype": "video", "shape": [*shape, 3], "names": ["height", "width", "channels"]}
    info = {
        "codebase_version": version, "fps": RATE, "chunks_size": 1000, "total_episodes": episodes,
        "data_path": data, "video_path": video,
        "features": {key: feature, "observation.state": {"dtype": "float32", "shape": [6]}},
    }  # fmt: skip
    return json.dumps(info)


def rows_of_episode(index: int, count: int, poses: Array | None) -> dict[str, list[Any]]:
    """The rows of an episode."""
    rows: dict[str, list[Any]] = {
        "episode_index": [index] * count,
        "timestamp": (np.arange(count) / RATE).tolist(),
    }
    return rows if poses is None else {**rows, "hand": poses[:count].tolist()}


def write_droid(folder: Path, episodes: Sequence[Sequence[Image]]) -> Path:
    """Write folders as DROID's, with a camera that stands and one on the wrist."""
    for i, images in enumerate(episodes):
        own = folder / "LAB" / "success" / f"2023-07-0{i + 1}"
        write_video(own / "recordings" / "MP4" / "111.mp4", images)
        write_video(own / "recordings" / "MP4" / "222.mp4", images[::-1])
        (own / "metadata_lab.json").write_text(json.dumps({"wrist_cam_serial": "222"}))
    return folder
