"""The file ``meta/calibration.json`` of a dataset: its accepted cameras, and what a check said of each episode.

The lens is in ROS's order and names, so that a reader needs no more than this file to project points.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np

from calibration.addons.guard.keeping import accepted_camera
from calibration.addons.guard.outcome import SensorCheck
from calibration.base import InputError, parse_json, read_bytes, write_atomically
from calibration.base.arrays import Array
from calibration.base.records import Misfit, between, field, length, read, record, text_of
from calibration.engine.baseline.calibration_document import CalibrationDocument, Name, Number, Positive, Three
from calibration.engine.estimation.options import LensModel
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS
from calibration.engine.geometry.transforms import from_xyz_rpy

FILE = Path("meta", "calibration.json")
MAX_BYTES = 16_000_000
Pixels = Annotated[int, between(1, 100_000)]


@record(kw_only=True)
class DatasetCamera:
    """A camera of a dataset, as accepted."""

    sensor: Name = field("Its name in the baseline.")
    width: Pixels = field("Of its images.", unit="px")
    height: Pixels = field("Of its images.", unit="px")
    model: LensModel = field("Lens model, as ROS names it.")
    intrinsics: Annotated[tuple[Number, ...], length(4, 40)] = field("fx, fy, cx, cy and the coefficients.")
    parent: Name | None = field("The frame in which its pose is: of a camera in the hand, the hand.", default=None)
    child: Name | None = field("Its own frame.", default=None)
    xyz_mm: Three | None = field("Its translation there.", unit="mm", default=None)
    rpy_deg: Three | None = field("Its rotation, as roll, pitch and yaw.", unit="degrees", default=None)
    sigma_mm: tuple[Positive, ...] | None = field("Standard deviations of the translation.", unit="mm", default=None)
    sigma_deg: tuple[Positive, ...] | None = field("And of the rotation.", unit="degrees", default=None)
    pose_column: Name | None = field(
        "Column with the pose of its parent in a frame that stands: x, y, z and roll, pitch, yaw, or a quaternion "
        "xyzw; of a camera that is carried. NAME[0:6] of one with more numbers.",
        default=None,
    )

    def __post_init__(self) -> None:
        """Refuse a lens of another number of parameters, and a carried camera without its mount.

        Raises:
            Misfit: names the key.
        """
        if len(self.intrinsics) != len(self.camera.parameters) or min(self.intrinsics[:2]) <= 0:
            raise Misfit(f"expected {', '.join(self.camera.parameters)}, with focal lengths above 0", "intrinsics")
        if self.pose_column is not None and (self.xyz_mm is None or self.rpy_deg is None):
            raise Misfit("found a column of poses, expected the camera's place there: xyz-mm and rpy-deg")

    @property
    def camera(self) -> Camera:
        """The camera."""
        plain = Camera(1.0, 1.0, 0.0, 0.0, self.width, self.height, MODELS[self.model]())
        return plain.with_intrinsics(np.array(self.intrinsics))

    @property
    def T_parent_camera(self) -> Array:
        """Its pose (4, 4); the identity if none is known."""
        return from_xyz_rpy(1e-3 * np.array(self.xyz_mm or (0, 0, 0)), np.radians(self.rpy_deg or (0, 0, 0)))

    @property
    def covariance(self) -> Array:
        """Covariance (6, 6) of its pose, m and rad; 0 where none is known."""
        sigmas = [*(1e-3 * np.array(self.sigma_mm or [0] * 3)), *np.radians(self.sigma_deg or [0] * 3)]
        return np.diag(np.square(sigmas))


@record
class DatasetCalibration:
    """What is accepted of the cameras of a dataset."""

    version: Literal[1] = field("Version of this format.")
    cameras: Annotated[Mapping[Name, DatasetCamera], length(0, 1000)] = field("By the keys of their features.")
    episodes: Annotated[Mapping[Name, Mapping[Name, str]], length(0, 1_000_000)] = field(
        "What a check said of each episode and camera.", default_factory=dict
    )


def read_dataset_calibration(path: Path) -> DatasetCalibration:
    """Read the file of a dataset; empty if there is none.

    Raises:
        InputError: it is not valid; names file and key.
    """
    if path.is_symlink():
        raise InputError(f"{path}: found a symbolic link, expected the file itself")
    if not path.exists():
        return DatasetCalibration(1, {})
    try:
        document = parse_json(read_bytes(path, MAX_BYTES, "a dataset's calibration"), finite=True)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: this is no calibration of a dataset: {error}") from None
    return read(DatasetCalibration, document, str(path))


def write_dataset_calibration(
    folder: Path, known: DatasetCalibration, checks: Mapping[str, tuple[SensorCheck, ...]]
) -> None:
    """Write what was checked into the file of a dataset.

    Raises:
        InfrastructureError: it cannot be written.
    """
    episodes = {name: {each.sensor: each.outcome for each in found} for name, found in checks.items()}
    written = DatasetCalibration(1, known.cameras, {**known.episodes, **episodes})
    write_atomically(folder / FILE, text_of(written))


def camera_of_dataset(
    sensor: str, camera: Camera, accepted: CalibrationDocument, pose_column: str | None = None
) -> DatasetCamera:
    """Return a camera of a dataset from an accepted calibration."""
    lens = accepted_camera(camera, accepted, sensor)
    pose = next((each for each in accepted.poses if each.sensor == sensor), None)
    return DatasetCamera(
        sensor=sensor,
        width=lens.width,
        height=lens.height,
        model=cast("LensModel", lens.distortion.ros_name),
        intrinsics=tuple(lens.intrinsics.tolist()),
        parent=pose.parent if pose else None,
        child=pose.child if pose else None,
        xyz_mm=pose.xyz_mm if pose else None,
        rpy_deg=pose.rpy_deg if pose else None,
        sigma_mm=pose.sigma_mm if pose else None,
        sigma_deg=pose.sigma_deg if pose else None,
        pose_column=pose_column,
    )
