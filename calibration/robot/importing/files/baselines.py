"""Baselines of a Kalibr camchain as the initial guess of transforms between cameras that no description has."""

from collections.abc import Collection, Mapping
from pathlib import Path

from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import Configuration
from calibration.engine.dataset.model import Edge
from calibration.engine.geometry.transforms import inverse
from calibration.robot.importing.files.camera_files import KnownLens


def with_baselines(
    transforms: Mapping[Edge, Array],
    configuration: Configuration,
    lenses: Mapping[str, KnownLens],
    known: Collection[Edge] = (),
) -> dict[Edge, Array]:
    """Place the cameras of a camchain that hang on one frame relative to the first of them, which stays.

    Args:
        transforms: ``T_parent_child`` (N, 4, 4) at each moment; of unknown ones the identity.
        configuration: the sensors.
        lenses: intrinsics of the cameras that have a file.
        known: transforms that the description or the recording has; these stay.
    """
    placed = dict(transforms)
    first: dict[tuple[Path, str], Array] = {}
    for name, sensor in configuration.sensors.items():
        edge = (sensor.parent_link, sensor.child_link)
        lens = lenses.get(name)
        if lens is None or lens.T_chain_camera is None or edge in known:
            continue
        T_first_chain = first.setdefault((lens.path, sensor.parent_link), inverse(lens.T_chain_camera))
        placed[edge] = placed[edge] @ T_first_chain @ lens.T_chain_camera
    return placed
