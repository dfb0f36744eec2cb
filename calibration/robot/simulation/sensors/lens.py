"""Lens of a camera or a depth camera, as in ``simulation.yml``."""

import math
from typing import Annotated

import numpy as np

from calibration.base.records import Converted, Misfit, between, excludes, field, one_of, record
from calibration.engine.estimation.solve.options import LensModel
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import MODELS
from calibration.engine.geometry.lenses.charts import IN_FRONT
from calibration.robot.simulation.description import listed

MAX_PIXELS = 25_000_000
"""Limit of an image's pixels: beyond it memory runs out."""
MAX_PINHOLE_HFOV_DEG, MAX_HFOV_DEG = 170, 350
"""Limits of the field of view of a pinhole and of other lenses, deg."""
_SIZE_IN_PIXELS = between(2, 100_000)


def _is_camera_matrix(K: tuple[float, ...]) -> bool:
    fx, skew, _, zero, fy, _, *last = K
    return min(fx, fy) > 0 and not skew and not zero and last == [0, 0, 1]


_CAMERA_MATRIX = listed(9, "[fx, 0, cx, 0, fy, cy, 0, 0, 1] with fx and fy above 0", _is_camera_matrix)


@record(
    case="snake",
    nulls=True,
    rules=(
        excludes("K", "hfov_deg"),
        excludes("K", "principal_point"),
        one_of("hfov_deg", "K", why="found neither hfov_deg nor K, expected one of them"),
    ),
)
class Lens:
    """Lens of a camera: its intrinsics and its distortion."""

    width: Annotated[int, _SIZE_IN_PIXELS] = field("Width of the image, px.")
    height: Annotated[int, _SIZE_IN_PIXELS] = field("Height of the image, px.")
    hfov_deg: Annotated[float, between(1, MAX_HFOV_DEG)] | None = field("Horizontal field of view, deg.", default=None)
    principal_point: Annotated[tuple[float, float], listed(2, "two numbers: cx, cy")] | None = field(
        "Principal point, px; by default Gazebo's, half a pixel beyond the centre.", default=None
    )
    K: Annotated[tuple[float, ...], _CAMERA_MATRIX] | None = field(
        "Camera matrix, row by row, in place of hfov_deg and principal_point.", default=None, key="K"
    )
    distortion_model: LensModel = field("Distortion model, by ROS's name.", default="plumb_bob")
    distortion: tuple[float, ...] | None = field(
        "Coefficients of the model; zeros where absent, but for eucm, double_sphere and omni those of the "
        "stereographic projection.",
        default=None,
    )

    def __post_init__(self) -> None:
        """Check the size of the image, and the number of coefficients."""
        if self.width * self.height > MAX_PIXELS:
            raise Misfit(f"found {self.width} x {self.height} pixels, expected {MAX_PIXELS} at most", "width")
        names = MODELS[self.distortion_model].names()
        if self.distortion is not None and len(self.distortion) != len(names):
            found = f"found a list of {len(self.distortion)}, expected a list of {len(names)}: {', '.join(names)}"
            raise Misfit(found, "distortion")
        if self.hfov_deg is not None and self.hfov_deg > (widest := self._widest_hfov_deg()):
            raise Misfit(f"found {self.hfov_deg:g}, expected a number from 1 to {widest:g}", "hfov_deg")

    def _widest_hfov_deg(self) -> float:
        """Return the largest field of view in whole degrees that the lens model can have, at most `MAX_HFOV_DEG`."""
        model = MODELS[self.distortion_model]
        if model.chart is IN_FRONT:
            return MAX_PINHOLE_HFOV_DEG
        lens = model(*(model.start if self.distortion is None else self.distortion))
        degrees = np.arange(1, MAX_HFOV_DEG + 1)
        return float(degrees[lens.sees(np.cos(np.radians(degrees) / 2))].max(initial=1))

    @property
    def camera(self) -> Camera:
        """Camera model."""
        model = MODELS[self.distortion_model]
        distortion = model(*(model.start if self.distortion is None else self.distortion))
        if self.K is not None:
            fx, _, cx, _, fy, cy, *_ = self.K
            return Camera(fx, fy, cx, cy, self.width, self.height, distortion)
        half = math.radians(self.hfov_deg or 0.0) / 2
        bent = distortion if model.is_wide else model()
        fx = self.width / 2 / float(bent.distort(np.array([model.chart.radius(half)]), np.zeros(1))[0][0])
        cx, cy = self.principal_point or (self.width / 2 + 0.5, self.height / 2 + 0.5)
        return Camera(fx, fx, cx, cy, self.width, self.height, distortion)


CAMERA_OF_LENS = Converted(Lens, lambda lens, _: lens.camera)
"""Camera model with the keys of `Lens`."""
