"""Unknowns that a user wants to keep as they are."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest

import numpy as np

from calibration.dataset.model import Dataset, Edge
from calibration.errors import InputError
from calibration.estimation.problem import Block, FreeJoint


def held_blocks(
    dataset: Dataset, blocks: tuple[Block, ...], edges: tuple[Edge, ...], hold: Sequence[str]
) -> tuple[Block, ...]:
    """The blocks, those that are named in ``hold`` held.

    A name is that of a sensor, of a transform ("parent-child"), of a pattern, of a joint
    ("joint-elbow") or of one of its parameters ("joint-elbow-origin_yaw"); of the intrinsics of a camera
    ("intrinsics-left") or of one of them ("intrinsics-left-k3").

    Args:
        dataset: the dataset.
        blocks: those of transforms first, then those of intrinsics.
        edges: of the former.
        hold: the names.

    Raises:
        InputError: there is nothing of a name, or a pattern to hold has no pose in the dataset.
    """
    out = list(blocks)
    names = [_names(dataset, block, edge) for block, edge in zip_longest(blocks, edges)]
    for name in hold:
        found = [i for i in range(len(blocks)) if name in names[i]]
        for i in found:
            out[i] = _held(out[i], name)
            if i < len(edges):
                _check(dataset, blocks[i], edges[i])
        if not found:
            known = [each for of_block in names for each in of_block]
            raise InputError(
                f"{dataset.path}: nothing to hold is called '{name}' (there are {', '.join(dict.fromkeys(known))})"
            )
    return tuple(out)


def _names(dataset: Dataset, block: Block, edge: Edge | None) -> list[str]:
    """What a block can be called."""
    names = [block.name, "-".join(edge)] if edge else [block.name]
    names += [sensor.name for sensor in dataset.sensors.values() if sensor.edge == edge]
    names += [f"{block.name}-{parameter}" for parameter in block.vector.free] if block.vector else []
    return names


def _held(block: Block, name: str) -> Block:
    """The block held; of a joint or a camera one parameter alone, if it is named."""
    parameter = name.removeprefix(f"{block.name}-")
    if block.vector is None or parameter not in block.vector.free:
        return replace(block, held=True)
    rest = block.vector.without(parameter)
    held = block.held or not rest.free
    if isinstance(rest, FreeJoint):
        return replace(block, joint=rest, held=held)
    return replace(block, intrinsics=rest, held=held)


def _check(dataset: Dataset, block: Block, edge: Edge) -> None:
    """Refuse to hold a pattern that has no pose to be held at."""
    if block.name in dataset.patterns:
        poses = dataset.transforms.get(edge)
        for i, collection in enumerate(dataset.collections):
            seen = any(pattern == block.name for pattern, _ in collection.labels)
            if seen and (poses is None or np.isnan(poses[i]).any()):
                key = "-".join(edge)
                raise InputError(
                    f"{dataset.path}: collections/{collection.key}/transforms: no '{key}', so pattern "
                    f"'{block.name}' cannot be held there"
                )
