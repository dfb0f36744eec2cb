"""Velocities of frames at the moments of collections: what a time offset of a sensor is multiplied by.

``collections/000/velocities/parent-child: {parent, child, twist: [vx, vy, vz, wx, wy, wz]}``: the velocity of the
child's frame in the parent's, along the child's own axes, m/s and rad/s. A transform without one stands still then.
Beside ``twist`` there may be ``acceleration`` and ``jerk``, 6 numbers each, m/s^2 and m/s^3 ...: a time t later the
transform is ``retract(T, twist t + acceleration t^2 / 2 + jerk t^3 / 6)``, by `calibration.engine.geometry.transforms`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.model import Edge

VELOCITIES_KEY = "velocities"
MAX_VELOCITY = 1e3
"""m/s and rad/s: limit of a velocity."""


ACCELERATION_KEYS = ("acceleration", "jerk")
FASTEST_CHANGE = 1e6
"""m/s^2, rad/s^2, m/s^3 and rad/s^3: limit of an acceleration and of a jerk."""


def read_velocities(collections: Sequence[Node]) -> tuple[dict[Edge, Array], dict[Edge, Array]]:
    """Parse the velocities (N, 6) of N collections, of each edge that has one, and (N, 2, 6) accelerations and jerks.

    Raises:
        InputError: something in them is missing or wrong.
    """
    velocities: dict[Edge, Array] = {}
    accelerations: dict[Edge, Array] = {}
    for number, collection in enumerate(collections):
        node = collection.get(VELOCITIES_KEY)
        for key, entry in node.items() if node else ():
            edge = (entry["parent"].name(), entry["child"].name())
            if key != "-".join(edge):
                raise entry.fault(f"found parent '{edge[0]}' and child '{edge[1]}', expected those of the key")
            own = _six_numbers(entry["twist"], MAX_VELOCITY, "m/s and rad/s")
            velocities.setdefault(edge, np.zeros((len(collections), 6)))[number] = own
            for order, name in enumerate(ACCELERATION_KEYS):
                if change := entry.get(name):
                    own = _six_numbers(change, FASTEST_CHANGE, "in m, rad and s,")
                    accelerations.setdefault(edge, np.zeros((len(collections), 2, 6)))[number, order] = own
    for each in (*velocities.values(), *accelerations.values()):
        each.flags.writeable = False
    return velocities, accelerations


def _six_numbers(node: Node, limit: float, units: str) -> list[float]:
    numbers = [each.within(-limit, limit) for each in node.elements()]
    if len(numbers) != 6:
        raise node.unexpected(f"6 numbers: {units} in the child's frame")
    return numbers


def velocity_documents(motions: Mapping[Edge, Array], number: int) -> dict[str, Any]:
    """Return the entries of one collection, by its number, of velocities, accelerations and jerks (N, 3, 6)."""
    return {
        "-".join(edge): {
            "parent": edge[0],
            "child": edge[1],
            **dict(zip(("twist", *ACCELERATION_KEYS), motion[number].tolist(), strict=True)),
        }
        for edge, motion in motions.items()
        if motion[number].any()
    }
