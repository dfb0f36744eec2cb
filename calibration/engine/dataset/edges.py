"""Transforms of all collections, parsed edge by edge in one pass."""

import math
from collections.abc import Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node, NotNumbersError, finite_rows
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry import rotations, transforms

QUATERNION_TOLERANCE = 1e-3
"""Tolerance of a quaternion's norm, which should be 1; quaternions are normalised."""
MAX_FRAME_DISTANCE_M = 1e9
"""m: limit of the distance of a frame from its parent."""

_frames_of = itemgetter("parent", "child")
_translation_of = itemgetter("trans")
_quaternion_of = itemgetter("quat")


def read_transforms(collections: Sequence[Node]) -> dict[Edge, Array]:
    """Parse the ``transforms`` of N collections: (N, 4, 4) for each edge; NaN where a collection lacks it.

    Raises:
        InputError: something in them is missing or wrong.
    """
    entries = [collection["transforms"].mapping() for collection in collections]
    slots: dict[Edge, int] = {}
    try:
        slot_of = _number_edges(entries, slots)
        translations = finite_rows([t for each in entries for t in map(_translation_of, each.values())], 3)
        quaternions = finite_rows([q for each in entries for q in map(_quaternion_of, each.values())], 4)
    except (NotNumbersError, KeyError, TypeError):
        slot_of, translations, quaternions = _one_by_one(collections, slots)
    with np.errstate(over="ignore"):
        lengths = np.sqrt((quaternions * quaternions).sum(-1))
    wrong = ~(abs(lengths - 1) <= QUATERNION_TOLERANCE)
    if wrong.any():
        row = int(wrong.argmax())
        raise _wrong_length(_entry_of_row(collections, row)["quat"], float(lengths[row]))
    far = (abs(translations) > MAX_FRAME_DISTANCE_M).any(-1)
    if far.any():
        raise _too_far(_entry_of_row(collections, int(far.argmax()))["trans"])
    if len(slots) * len(entries) > 16 * len(slot_of) + 1_000_000:
        raise collections[0].fault(
            f"the {len(entries)} collections have {len(slots)} different transforms but only {len(slot_of)} in all; "
            "expected nearly the same ones in every collection"
        )
    T = np.full((len(slots), len(entries), 4, 4), np.nan)
    owner = np.repeat(np.arange(len(entries)), [len(each) for each in entries])
    T[slot_of, owner] = transforms.from_quaternion(translations, quaternions)
    T.flags.writeable = False
    return dict(zip(slots, T, strict=True))


def read_transform(node: Node) -> tuple[Edge, Array]:
    """Parse a single transform (4, 4) and its edge.

    Raises:
        InputError: something in it is missing or wrong.
    """
    edge = (node["parent"].name(), node["child"].name())
    translation, quaternion = node["trans"].numbers(3), node["quat"].numbers(4)
    length = math.hypot(*quaternion)
    if not abs(length - 1) <= QUATERNION_TOLERANCE:
        raise _wrong_length(node["quat"], length)
    if max(map(abs, translation)) > MAX_FRAME_DISTANCE_M:
        raise _too_far(node["trans"])
    return edge, transforms.from_quaternion(translation, quaternion)


def read_pose(node: Node, far: float) -> Array:
    """Parse a pose (4, 4) in the form of ROS messages: ``position`` and ``orientation``.

    Raises:
        InputError: something in it is missing or wrong, or it is farther away than ``far``, m.
    """
    position, orientation = node["position"], node["orientation"]
    quaternion = [orientation[axis].number() for axis in "xyzw"]
    length = math.hypot(*quaternion)
    if not abs(length - 1) <= QUATERNION_TOLERANCE:
        raise _wrong_length(orientation, length)
    return transforms.from_quaternion([position[axis].within(-far, far) for axis in "xyz"], quaternion)


def pose_document(T: Array) -> dict[str, Any]:
    """Return a pose (4, 4) in the form that `read_pose` reads."""
    position, quaternion = T[:3, 3].tolist(), rotations.to_quaternion(T[:3, :3]).tolist()
    return {
        "position": dict(zip("xyz", position, strict=True)),
        "orientation": dict(zip("xyzw", quaternion, strict=True)),
    }


def transform_documents(edge: Edge, T: Array) -> list[dict[str, Any]]:
    """Return the document entries of an edge's transforms (N, 4, 4)."""
    translations, quaternions = T[:, :3, 3].tolist(), rotations.to_quaternion(T[:, :3, :3]).tolist()
    return [
        {"parent": edge[0], "child": edge[1], "trans": trans, "quat": quat}
        for trans, quat in zip(translations, quaternions, strict=True)
    ]


def is_constant(T: Array) -> bool:
    """Whether a transform (N, 4, 4) is the same in all collections that have it."""
    present = T[~np.isnan(T[:, 0, 0])]
    return bool((abs(present - present[:1]) <= 1e-9).all())


def _number_edges(entries: Sequence[dict[str, dict[str, object]]], slots: dict[Edge, int]) -> list[int]:
    """Number the edges in ``slots``, in order of appearance, and return the number of each transform's edge.

    Raises:
        KeyError, TypeError: a frame is missing, is not text, or does not fit the key.
    """
    numbers: list[int] = []
    keys: list[str] = []
    frames: list[Edge] = []
    here: list[int] = []
    for each in entries:
        previous, frames = frames, list(map(_frames_of, each.values()))
        if frames != previous or list(each) != keys:  # most collections repeat the frames of the previous one
            keys = list(each)
            for key, (parent, child) in zip(keys, frames, strict=True):
                if type(parent) is not str or type(child) is not str or key != f"{parent}-{child}":
                    raise KeyError(key)
            here = [slots.setdefault(edge, len(slots)) for edge in frames]
        numbers += here
    return numbers


def _one_by_one(collections: Sequence[Node], slots: dict[Edge, int]) -> tuple[list[int], Array, Array]:
    """Parse like `read_transforms`, but one by one, to report the first invalid transform."""
    slot_of, translations, quaternions = [], [], []
    for collection in collections:
        for key, entry in collection["transforms"].items():
            parent, child = entry["parent"].text(), entry["child"].text()
            if key != f"{parent}-{child}":
                raise entry.fault(f"found parent '{parent}' and child '{child}', expected those of the key")
            slot_of.append(slots.setdefault((parent, child), len(slots)))
            translations.append(entry["trans"].numbers(3))
            quaternions.append(entry["quat"].numbers(4))
    return slot_of, np.array(translations).reshape(-1, 3), np.array(quaternions).reshape(-1, 4)


def _entry_of_row(collections: Sequence[Node], row: int) -> Node:
    """Return the document entry of a transform by its index over all collections."""
    for collection in collections:
        keys = list(collection["transforms"].mapping())
        if row < len(keys):
            return collection["transforms"][keys[row]]
        row -= len(keys)
    raise AssertionError("the row is one of the transforms'")


def _too_far(translation: Node) -> InputError:
    return translation.fault(f"found a frame that is more than {MAX_FRAME_DISTANCE_M:g} m away, expected m")


def _wrong_length(quaternion: Node, length: float) -> InputError:
    expected = f"[x, y, z, w] of length 1 (within {QUATERNION_TOLERANCE:g})"
    return quaternion.fault(f"found a quaternion of length {length:.6g}, expected {expected}")
