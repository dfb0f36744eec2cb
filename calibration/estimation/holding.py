"""Unknowns that a user wants to keep as they are."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.dataset.model import Dataset, Edge
from calibration.errors import InputError
from calibration.estimation.problem import Block, FreeJoint


def held_blocks(
    dataset: Dataset, blocks: tuple[Block, ...], edges: tuple[Edge, ...], hold: Sequence[str]
) -> tuple[Block, ...]:
    """The blocks, those that are named in ``hold`` held.

    A name is that of a sensor, of a transform ("parent-child"), of a pattern, of a joint
    ("joint-elbow") or of one of its parameters ("joint-elbow-origin_yaw").

    Raises:
        InputError: there is nothing of a name, or a pattern to hold has no pose in the dataset.
    """
    out = list(blocks)
    for name in hold:
        found = [i for i in range(len(blocks)) if name in _names(dataset, blocks[i], edges[i])]
        for i in found:
            out[i] = _held(out[i], name)
            _check(dataset, blocks[i], edges[i])
        if not found:
            known = [each for i in range(len(blocks)) for each in _names(dataset, blocks[i], edges[i])]
            raise InputError(
                f"{dataset.path}: nothing to hold is called '{name}' (there are {', '.join(dict.fromkeys(known))})"
            )
    return tuple(out)


def _names(dataset: Dataset, block: Block, edge: Edge) -> list[str]:
    """What a block can be called."""
    names = [block.name, "-".join(edge)]
    names += [sensor.name for sensor in dataset.sensors.values() if sensor.edge == edge]
    names += [f"{block.name}-{parameter}" for parameter in block.joint.free] if block.joint else []
    return names


def _held(block: Block, name: str) -> Block:
    """The block held; of a joint one parameter alone, if it is named."""
    parameter = name.removeprefix(f"{block.name}-")
    if block.joint is None or parameter not in block.joint.free:
        return replace(block, held=True)
    free = tuple(each for each in block.joint.free if each != parameter)
    return replace(block, joint=FreeJoint(block.joint.model, free), held=block.held or not free)


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
