"""Good recordings beside the project, as documents: public ones of arms and cameras, and a newcomer's."""

import gzip
import json
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

from benchmarks.shared_data import FOLDER

Document = dict[str, Any]
DOOR = FOLDER / "door"
ABSENT = "no ../shared/data/door: it is not part of the project"


def _read(path: Path) -> Document:
    content = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    document: Document = json.loads(content)
    return document


def _dataset(folder: str) -> Callable[[], Document]:
    return lambda: _read(DOOR / "real" / folder / "data" / "robot" / "dataset.json")


def _newcomer_arm() -> Document:
    """The rendered arm, whose declared squares are 2 % too large in the file, with those that are printed."""
    return with_scaled_board(_read(DOOR / "newcomer" / "04-init-forgives-square" / "dataset.json.gz"), 35.0 / 35.7)


def _right_way() -> Document:
    """Pairs of poses whose pattern's poses are inverse in the file, turned round."""
    return each_measured(_dataset("09-pairs-inverse")(), inverse_pose)


def _webcams() -> Document:
    """The stereo rig whose right images are one pair late in the file, paired again."""
    return shifted(_dataset("23-stereo-no-minimum/shifted")(), -1, ("right",))


RECORDINGS: dict[str, tuple[str, Callable[[], Document]]] = {
    "UR5, fixed camera": ("arm", _dataset("02-green-mistakes/good")),
    "KUKA, fixed camera": ("arm", _dataset("04-symmetric-board-180-deg")),
    "rendered arm": ("arm", _newcomer_arm),
    "UR5, pairs of poses": ("pairs", _right_way),
    "AUBO, pairs of poses": ("pairs", _dataset("10-baseline-rejected-share")),
    "two webcams": ("cameras", _webcams),
    "two rendered cameras": ("cameras", lambda: _read(DOOR / "newcomer/02-far-recording-red/accepted.dataset.json.gz")),
    "t2rgb of the paper": ("cameras", lambda: _read(FOLDER / "t2rgb-paper" / "dataset.json")),
}
"""By name: what kind of recording it is, and its document."""


def missing() -> str:
    """Reason why the recordings cannot be used; empty if they can."""
    return "" if DOOR.is_dir() else ABSENT


def inverse_pose(trans: list[float], quat: list[float]) -> tuple[list[float], list[float]]:
    """The inverse of a pose: translation, and quaternion xyzw."""
    x, y, z, w = -quat[0], -quat[1], -quat[2], quat[3]
    return [-each for each in rotated([x, y, z, w], trans)], [x, y, z, w]


def rotated(quat: list[float], v: list[float]) -> list[float]:
    """A vector rotated by a quaternion xyzw."""
    x, y, z, w = quat
    t = [2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])]
    return [
        v[0] + w * t[0] + y * t[2] - z * t[1],
        v[1] + w * t[1] + z * t[0] - x * t[2],
        v[2] + w * t[2] + x * t[1] - y * t[0],
    ]


Change = Callable[[list[float], list[float]], tuple[list[float], list[float]]]
"""A change of a pose: of its translation, and of its rotation as a quaternion xyzw."""


def each_measured(document: Document, change: Change) -> Document:
    """The document with the measured poses of the pattern changed."""
    document = deepcopy(document)
    for views in every_view(document):
        for view in views.values():
            for label in view["idxs"]:
                place, turn = label["position"], label["orientation"]
                t, q = change([place[k] for k in "xyz"], [turn[k] for k in "xyzw"])
                label["position"] = dict(zip("xyz", t, strict=True))
                label["orientation"] = dict(zip("xyzw", q, strict=True))
    return document


def each_arm_pose(document: Document, change: Change) -> Document:
    """The document with the poses of the arm changed: of the only transform that differs between collections."""
    document = deepcopy(document)
    collections = list(document["collections"].values())
    first = collections[0]["transforms"]
    moving = [k for k in first if any(c["transforms"][k]["quat"] != first[k]["quat"] for c in collections)]
    for collection in collections:
        for key in moving:
            transform = collection["transforms"][key]
            transform["trans"], transform["quat"] = change(transform["trans"], transform["quat"])
    return document


def every_view(document: Document) -> list[dict[str, Any]]:
    """The labels by sensor, of each collection and pattern."""
    found = []
    for collection in document["collections"].values():
        labels = collection["labels"]
        by_sensor = all("idxs" in each for each in labels.values())  # ATOM's version 2 has one pattern
        found += [labels] if by_sensor else list(labels.values())
    return found


def shifted(document: Document, by: int, sensors: tuple[str, ...]) -> Document:
    """The document with some sensors' labels, or all, taken from the collection that is ``by`` later."""
    document = deepcopy(document)
    views = every_view(document)
    before = deepcopy(views)
    keys = list(document["collections"])
    for i, view in enumerate(views):
        for sensor in sensors or tuple(view):
            if 0 <= i + by < len(views):
                view[sensor] = before[i + by][sensor]
            else:
                document["collections"].pop(keys[i], None)
    return document


def with_scaled_board(document: Document, by: float) -> Document:
    """The document with the squares of its patterns declared larger by a factor."""
    document = deepcopy(document)
    for pattern in document["calibration_config"]["calibration_patterns"].values():
        pattern["size"] *= by
        if pattern["inner_size"]:
            pattern["inner_size"] *= by
    for geometry in document.get("patterns", {}).values():
        corners = [*geometry["corners"], *geometry["frame"]["corners"].values()]
        sampled = [point for side in geometry["frame"]["lines_sampled"].values() for point in side]
        for point in [*corners, *sampled]:
            point["x"] *= by
            point["y"] *= by
    return document
