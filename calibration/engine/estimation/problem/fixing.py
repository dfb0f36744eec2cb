"""Parameters that the user fixes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.base.errors import InputError
from calibration.engine.dataset.model import Dataset
from calibration.engine.estimation.problem.blocks import Block, Pose


def held_blocks(dataset: Dataset, blocks: Sequence[Block], hold: Sequence[str]) -> tuple[Block, ...]:
    """Return the blocks, with those named in ``hold`` fixed.

    A name is that of a sensor, of a transform ("parent-child"), of a pattern, of a joint
    ("joint-elbow") or of one of its parameters ("joint-elbow-origin_yaw"); of the intrinsics of a camera
    ("intrinsics-left") or of one of them ("intrinsics-left-k3").

    Raises:
        InputError: a name is unknown, or a fixed pattern has no pose in the dataset.
    """
    out = list(blocks)
    names = [_names_of_block(dataset, block) for block in blocks]
    for name in hold:
        found = [i for i in range(len(blocks)) if name in names[i]]
        for i in found:
            out[i] = _fix_block(out[i], name)
            _refuse_pattern_without_pose(dataset, blocks[i])
        if not found:
            known = [each for of_block in names for each in of_block]
            raise InputError(
                f"{dataset.path}: nothing to hold is called '{name}' (there are {', '.join(dict.fromkeys(known))})"
            )
    return tuple(out)


def _names_of_block(dataset: Dataset, block: Block) -> list[str]:
    """Return the names of a block."""
    names = [block.name, "-".join(block.edge)] if block.edge else [block.name]
    names += [sensor.name for sensor in dataset.sensors.values() if sensor.edge == block.edge]
    return names + [f"{block.name}-{parameter}" for parameter in block.parameters.free]


def _fix_block(block: Block, name: str) -> Block:
    """Fix a block; or only the named parameter of a joint or a camera."""
    parameter = name.removeprefix(f"{block.name}-")
    if isinstance(block.parameters, Pose) or parameter not in block.parameters.free:
        return replace(block, held=True)
    rest = block.parameters.without(parameter)
    return replace(block, parameters=rest, held=block.held or not rest.free)


def _refuse_pattern_without_pose(dataset: Dataset, block: Block) -> None:
    """Refuse to fix a pattern without a pose."""
    if block.name in dataset.patterns and block.edge:
        poses = dataset.transforms.get(block.edge)
        for i, collection in enumerate(dataset.collections):
            seen = any(pattern == block.name for pattern, _ in collection.labels)
            if seen and (poses is None or np.isnan(poses[i]).any()):
                key = "-".join(block.edge)
                raise InputError(
                    f"{dataset.path}: collections/{collection.key}/transforms: no '{key}', so pattern "
                    f"'{block.name}' cannot be held there"
                )
