"""Joints with calibrated parameters, from the configuration and the collections."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.model import Edge, Joint
from calibration.engine.geometry.joints import JOINT_PARAMETERS, JointModel, JointParameter

_IS_PRISMATIC = {"revolute": False, "continuous": False, "prismatic": True}
MAX_JOINT_VALUE = 1e6
"""m or rad: limit of a joint's origin."""
_MAX_ORIGIN_DIFFERENCE = 1e-9
"""Tolerance (m, rad) of a joint's origin between collections."""


def read_joints(config: Node, collections: Sequence[Node]) -> dict[str, Joint]:
    """Parse the joints of a dataset's ``calibration_config/joints``, with their positions in each collection.

    The origin, the axis and the kind are those of the first collection, and the same in all.

    Raises:
        InputError: something in them is missing or wrong.
    """
    if not (asked := config.get("joints")):
        return {}
    there = collections[0]["joints"].mapping() if asked.mapping() else {}
    for name, node in asked.items():
        if name not in there:
            raise node.fault(
                f"collection {collections[0].keys[-1]} has no joint of this name "
                f"(there are: {', '.join(there) or 'none'})"
            )
    return {name: _read_joint(name, node, collections) for name, node in asked.items()}


def joint_values(joint: Joint) -> dict[str, float]:
    """Return the current parameters of a joint, by the names that they have in a document."""
    return dict(zip(JOINT_PARAMETERS, joint.values.tolist(), strict=True))


def joint_document(joint: Joint, read: Mapping[str, Any], i: int) -> dict[str, Any]:
    """Return the document entry of a joint in collection i, with its current parameters."""
    values = joint_values(joint)
    bias = values.pop("position_bias")
    document = {**read, **values, "position": float(joint.positions[i])}
    return {**document, "position_bias": bias} if bias or "position_bias" in read else document


def _read_joint(name: str, asked: Node, collections: Sequence[Node]) -> Joint:
    entries = [collection["joints"][name] for collection in collections]
    model, edge, values = _read_model(entries[0]), _edge_of_links(entries[0]), _read_values(entries[0])
    for entry in entries[1:]:
        if (
            _edge_of_links(entry) != edge
            or _read_model(entry) != model
            or np.abs(_read_values(entry) - values).max() > _MAX_ORIGIN_DIFFERENCE
        ):
            raise entry.fault(
                f"differs from collection {collections[0].keys[-1]}; only the position of a joint changes"
            )
    return Joint(
        name=name,
        edge=edge,
        model=model,
        parameters=_calibrated_parameters(asked),
        values=values,
        positions=np.array([entry["position"].within(-MAX_JOINT_VALUE, MAX_JOINT_VALUE) for entry in entries]),
    )


def _calibrated_parameters(asked: Node) -> tuple[JointParameter, ...]:
    chosen = {element.name(): element for element in asked["params_to_calibrate"].elements()}
    for name, element in chosen.items():
        if name not in JOINT_PARAMETERS:
            raise element.unexpected(f"one of {', '.join(JOINT_PARAMETERS)}")
    if not chosen:
        raise asked["params_to_calibrate"].unexpected("at least one parameter")
    return tuple(parameter for parameter in JOINT_PARAMETERS if parameter in chosen)


def _read_model(entry: Node) -> JointModel:
    kind = entry["joint_type"]
    if kind.text() not in _IS_PRISMATIC:
        raise kind.unexpected("a joint that moves: " + " or ".join(_IS_PRISMATIC))
    axis = np.array([entry[f"axis_{c}"].number() for c in "xyz"])
    length = float(np.linalg.norm(axis))
    if not 1e-6 < length < 1e6:
        raise entry["axis_x"].fault(f"found the axis ({axis[0]:g}, {axis[1]:g}, {axis[2]:g}), expected a direction")
    x, y, z = (axis / length).tolist()
    return JointModel(_IS_PRISMATIC[kind.value], (x, y, z))


def _edge_of_links(entry: Node) -> Edge:
    return (entry["parent_link"].name(), entry["child_link"].name())


def _read_values(entry: Node) -> Array:
    bias = entry.get("position_bias")
    origin = [entry[parameter].within(-MAX_JOINT_VALUE, MAX_JOINT_VALUE) for parameter in JOINT_PARAMETERS[:6]]
    return np.array([*origin, bias.within(-MAX_JOINT_VALUE, MAX_JOINT_VALUE) if bias else 0.0])
