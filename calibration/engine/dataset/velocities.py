"""Velocities of frames at the moments of collections: what a time offset of a sensor is multiplied by.

``collections/000/velocities/parent-child: {parent, child, twist: [vx, vy, vz, wx, wy, wz]}``: the velocity of the
child's frame in the parent's, along the child's own axes, m/s and rad/s. A transform without one stands still then.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.model import Edge

KEY = "velocities"
FASTEST = 1e3
"""m/s and rad/s: limit of a velocity."""


def read_velocities(collections: Sequence[Node]) -> dict[Edge, Array]:
    """Parse the velocities of N collections: (N, 6) for each edge that has one in any of them.

    Raises:
        InputError: something in them is missing or wrong.
    """
    found: dict[Edge, Array] = {}
    for number, collection in enumerate(collections):
        node = collection.get(KEY)
        for key, entry in node.items() if node else ():
            edge = (entry["parent"].name(), entry["child"].name())
            if key != "-".join(edge):
                raise entry.fault(f"found parent '{edge[0]}' and child '{edge[1]}', expected those of the key")
            twist = [each.within(-FASTEST, FASTEST) for each in entry["twist"].elements()]
            if len(twist) != 6:
                raise entry["twist"].unexpected("6 numbers: m/s and rad/s in the child's frame")
            found.setdefault(edge, np.zeros((len(collections), 6)))[number] = twist
    for velocity in found.values():
        velocity.flags.writeable = False
    return found


def velocity_documents(velocities: Mapping[Edge, Array], number: int) -> dict[str, Any]:
    """Return the entries of one collection, by its number."""
    return {
        "-".join(edge): {"parent": edge[0], "child": edge[1], "twist": velocity[number].tolist()}
        for edge, velocity in velocities.items()
        if velocity[number].any()
    }
