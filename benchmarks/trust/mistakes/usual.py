"""The usual mistakes: what is planted in which recordings, and the words of a first reason that names it."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from benchmarks.trust.mistakes.recordings import (
    Change,
    Document,
    each_arm_pose,
    each_measured,
    every_view,
    inverse_pose,
    shifted,
    with_scaled_board,
)
from calibration.engine.geometry import rotations


@dataclass(frozen=True)
class Mistake:
    """A mistake that people make."""

    name: str
    kinds: tuple[str, ...]
    """Kinds of recordings in which it can be made."""
    plant: Callable[[Document], Document]
    words: tuple[str, ...]
    """A first reason that has one of them names it."""
    only: tuple[str, ...] = ()
    """Recordings in which it can be made, where not in all of these kinds."""


def _turned(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """A change of a pose whose rotation (3, 3) is misread."""

    def changed(trans: list[float], quat: list[float]) -> tuple[list[float], list[float]]:
        R = change(rotations.from_quaternion(np.array(quat)))
        return trans, rotations.to_quaternion(R).tolist()

    return changed


def _wxyz(trans: list[float], quat: list[float]) -> tuple[list[float], list[float]]:
    x, y, z, w = quat
    return trans, [w, x, y, z]


def _longer(by: float) -> Change:
    return lambda trans, quat: ([by * each for each in trans], quat)


def _left_handed(trans: list[float], quat: list[float]) -> tuple[list[float], list[float]]:
    x, y, z, w = quat
    return [trans[0], -trans[1], trans[2]], [-x, y, -z, w]


def _rpy_as_vector(R: np.ndarray) -> np.ndarray:
    return rotations.exp(rotations.to_rpy(R))


def _vector_as_rpy(R: np.ndarray) -> np.ndarray:
    return rotations.from_rpy(rotations.log(R))


def _other_order(R: np.ndarray) -> np.ndarray:
    return rotations.from_rpy(rotations.to_rpy(R)[::-1])


def _arm(change: Change) -> Callable[[Document], Document]:
    return lambda document: each_arm_pose(document, change)


def _seen(change: Change) -> Callable[[Document], Document]:
    return lambda document: each_measured(document, change)


def mounted_the_other_way(document: Document) -> Document:
    """The sensor on the base and the pattern on the tool, or the other way round than it is."""
    document = deepcopy(document)
    config = document["calibration_config"]
    ((name, sensor),), (pattern,) = config["sensors"].items(), config["calibration_patterns"].values()
    before, now = sensor["parent_link"], pattern["parent_link"]
    sensor["parent_link"], pattern["parent_link"] = now, before
    entry = document["sensors"][name]
    entry["calibration_parent"] = now
    old, new = f"{before}-{sensor['child_link']}", f"{now}-{sensor['child_link']}"
    for collection in document["collections"].values():
        transform = collection["transforms"].pop(old)
        collection["transforms"][new] = {**transform, "parent": now}
    path = [("world", "base_link"), *([("base_link", "tool0")] if now == "tool0" else []), (now, sensor["child_link"])]
    entry["chain"] = [{"parent": a, "child": b, "key": f"{a}-{b}"} for a, b in path]
    return document


def _exchanged_camera_info(document: Document) -> Document:
    document = deepcopy(document)
    a, b = list(document["sensors"].values())[:2]
    a["camera_info"], b["camera_info"] = b["camera_info"], a["camera_info"]
    return document


def _exchanged_in_half(document: Document) -> Document:
    """Left and right exchanged in every second collection."""
    document = deepcopy(document)
    for view in every_view(document)[::2]:
        a, b = list(view)[:2]
        view[a], view[b] = view[b], view[a]
    return document


def _turned_in_one(document: Document) -> Document:
    """The chessboard numbered from its other end by the second camera."""
    document = deepcopy(document)
    for view in every_view(document):
        labels = view[list(view)[1]]["idxs"]
        last = 9 * 6 - 1
        for label in labels:
            label["id"] = last - label["id"]
    return document


def _mirrored_right(document: Document) -> Document:
    """The second camera's images mirrored by its driver, and the board found in them as if they were not."""
    document = deepcopy(document)
    name = list(document["sensors"])[1]
    width = document["sensors"][name]["camera_info"]["width"]
    for view in every_view(document):
        for label in view[name]["idxs"]:
            row, column = divmod(label["id"], 9)
            label["id"], label["x"] = 9 * row + 8 - column, width - 1 - label["x"]
    return document


def _resolution(document: Document) -> Document:
    """camera_info of images of half the size."""
    document = deepcopy(document)
    info = next(iter(document["sensors"].values()))["camera_info"]
    info["K"] = [each / 2 if i < 6 else each for i, each in enumerate(info["K"])]
    return document


ARMS, PAIRS, CAMERAS = ("arm",), ("pairs",), ("cameras",)
ON_ARMS = (*ARMS, *PAIRS)
INVERSE = ("inverted", "other way round")
MISTAKES = (
    Mistake("robot's poses inverse", ON_ARMS, _arm(inverse_pose), INVERSE),
    Mistake("mounted the other way round", ON_ARMS, mounted_the_other_way, INVERSE),
    Mistake("quaternions w first", ON_ARMS, _arm(_wxyz), ("wxyz",)),
    Mistake("roll, pitch, yaw read as a rotation vector", ON_ARMS, _arm(_turned(_rpy_as_vector)), ("Euler angles",)),
    Mistake("rotation vectors read as roll, pitch, yaw", ON_ARMS, _arm(_turned(_vector_as_rpy)), ("rotation vectors",)),
    Mistake("Euler angles in another order", ON_ARMS, _arm(_turned(_other_order)), ("Euler angles",)),
    Mistake("rotation matrices transposed", ON_ARMS, _arm(_turned(lambda R: R.T)), ("transpose", "wxyz")),
    Mistake("robot's poses in mm", ON_ARMS, _arm(_longer(1000.0)), ("mm", "millimetres")),
    Mistake("left-handed poses", ON_ARMS, _arm(_left_handed), ("left-handed",)),
    Mistake("poses one image late", ON_ARMS, lambda d: shifted(d, 1, ()), ("earlier",)),
    Mistake("squares 5 % too large", ARMS, lambda d: with_scaled_board(d, 1.05), ("squares", "size")),
    Mistake("board printed to fit the page", ARMS, lambda d: with_scaled_board(d, 1 / 0.96), ("squares", "size")),
    Mistake("squares 20 % too large", ARMS, lambda d: with_scaled_board(d, 1.2), ("squares", "size")),
    Mistake("camera_info of half the resolution", ARMS, _resolution, ("resolution", "focal length")),
    Mistake("pattern's poses inverse", PAIRS, _seen(inverse_pose), INVERSE),
    Mistake("pattern's quaternions w first", PAIRS, _seen(_wxyz), ("wxyz",)),
    Mistake("pattern's poses in mm", PAIRS, _seen(_longer(1000.0)), ("mm", "millimetres")),
    Mistake("pattern's poses 20 % too long", PAIRS, _seen(_longer(1.2)), ("pattern's poses",)),
    Mistake("right images one pair late", CAMERAS, lambda d: shifted(d, 1, (list(d["sensors"])[1],)), ("earlier",)),
    Mistake(
        "camera_info exchanged",
        CAMERAS,
        _exchanged_camera_info,
        ("exchanged",),
        ("two rendered cameras",),
    ),
    Mistake("left and right exchanged in half", CAMERAS, _exchanged_in_half, ("contradict each other", "exchanged")),
    Mistake("right images mirrored", CAMERAS, _mirrored_right, ("mirrored",), ("two webcams",)),
    Mistake("board numbered from its other end by one camera", CAMERAS, _turned_in_one, ("turned",), ("two webcams",)),
)
