"""Simulated depth cameras: depth images, and their pixels on patterns."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar

import cv2
import numpy as np

from calibration.base import InputError
from calibration.base.arrays import Array, BoolArray
from calibration.base.records import between, field, record
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.modalities import DEPTH, Modality, NoiseKind
from calibration.engine.dataset.model import PointLabels
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.dataset.sensor_data import DEPTH_UNIT_M, NO_RETURN, read_depth_image
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import apply, inverse
from calibration.robot.labelling.depth import away_from_edge, label_depth
from calibration.robot.labelling.detection import DepthImage, Image
from calibration.robot.simulation.rendering.background import background, rays, rounded
from calibration.robot.simulation.scene import Board, Scene, rising
from calibration.robot.simulation.sensors.camera import CAMERA_OF_LENS, encode_image, image_message
from calibration.robot.simulation.sensors.sensor import (
    LEAST_SHARE,
    NO_DATA_COLOUR,
    ON_BORDER,
    ON_PATTERN,
    PICTURE_HEIGHT_PX,
    Data,
    Found,
    RangeSensor,
    Views,
    blank,
    corners_in_image,
    facing,
    meets,
    range_noise,
)

MAX_EXPECTED_LABELS = 5000
"""Approximate limit of the expected number of labelled pixels, as in `calibration.robot.labelling.depth`."""
_FROM_NEAR = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[::-1, None], cv2.COLORMAP_BONE)[:, 0]


@record(case="snake", nulls=True)
class SimulatedDepthCamera(RangeSensor):
    """Camera that measures the depth along its optical axis."""

    modality: ClassVar[Modality] = DEPTH
    label_name: ClassVar[str] = "pixels"
    file_ending: ClassVar[str] = "png"
    scenario_group: ClassVar[str] = "depth_cameras"

    camera: Annotated[Camera, CAMERA_OF_LENS] = field(flat=True)
    noise: Annotated[float, between(0, 10)] = field(
        "Standard deviation of a depth near the camera, m.", default=0.001, key="noise_m"
    )
    noise_growth: Annotated[float, between(0, 10)] = field(
        "Noise per square of the depth, m per m^2, as of triangulation.",
        default=0.0015,
        key="noise_per_m2",
    )
    reach: Annotated[tuple[float, float], rising(0)] = field(
        "Least and largest depth along the optical axis; other surfaces give none, m.",
        default=(0.3, 6.5),
        key="range_m",
    )

    @property
    def intrinsics(self) -> Camera:
        """Intrinsics."""
        return self.camera

    def render(
        self, T_world_sensor: Array, scene: Scene, boards: Sequence[Board], random: np.random.Generator
    ) -> DepthImage:
        """Render the depth image (height, width), along the optical axis, in units of `DEPTH_UNIT_M`.

        Each pixel measures the nearest surface at its centre. `NO_RETURN` if there is none, or it is out of
        range, or beyond 16 bits.
        """
        noise = random.standard_normal((self.camera.height, self.camera.width), dtype=np.float32)
        pose = rounded(T_world_sensor)
        depth = background(self.camera, pose, scene).depth
        directions = rays(self.camera)[:, 1:-1, 1:-1]
        for board in boards:
            T_camera_pattern = inverse(pose) @ rounded(board.T_world_pattern)
            depth = np.minimum(depth, board.cast_in(T_camera_pattern, directions))
        in_range = (depth >= self.least_range) & (depth <= self.most_range) & (directions[2] == 1)
        depth = np.where(in_range, depth, 0.0)
        measured = depth + (self.noise + self.noise_growth * depth**2) * noise
        counts = np.rint(measured / DEPTH_UNIT_M)
        return np.where(in_range & (counts >= 0) & (counts < NO_RETURN), counts, NO_RETURN).astype(np.uint16)

    def message(self, data: Data) -> dict[str, Any]:
        """Return the fields of an Image."""
        return image_message(self.camera, "16UC1", 2)

    def encode(self, data: Data) -> bytes:
        """Encode as a 16-bit PNG."""
        return encode_image(data, ".png", [cv2.IMWRITE_PNG_COMPRESSION, 6])

    def label(self, data: Data, pattern: PatternConfiguration, T_sensor_pattern: Array) -> Found:
        """Find the pixels on the pattern."""
        return label_depth(data, self.camera, pattern.pattern(), T_sensor_pattern)

    def detects(self, views: Views) -> BoolArray:
        """Return a mask (N,) of the poses with enough of the pattern in range, by the pattern's corners."""
        places = views.pattern.corners
        corners = apply(views.T_sensor_pattern, places)
        _, visible = corners_in_image(self.camera, corners)
        visible &= (corners[..., 2] > self.least_range) & (corners[..., 2] < self.most_range)
        visible &= ~views.hidden(places)
        return np.asarray(facing(views.T_sensor_pattern, views.pattern.centre) & (visible.mean(-1) >= LEAST_SHARE))

    def points_on(self, views: Views, number: int) -> PointLabels:
        """Return the points of the pixels on the pattern, evenly thinned.

        Those with a neighbouring pixel outside of the pattern are on the border, except near the image's edge.
        """
        camera = self.camera
        directions = np.moveaxis(rays(camera), 0, -1)  # with a margin of one pixel on every side
        depth, hits = meets(views.pattern, views.T_sensor_pattern[number], directions)
        hits &= directions[..., 2] == 1  # to the front
        inner = hits[:-2, 1:-1] & hits[2:, 1:-1] & hits[1:-1, :-2] & hits[1:-1, 2:]
        v, u = np.nonzero(hits[1:-1, 1:-1])
        border = ~inner[v, u] & away_from_edge((camera.height, camera.width), v, u)
        labelled = border.copy()
        labelled[:: max(1, -(-len(v) // MAX_EXPECTED_LABELS))] = True
        v, u, border = v[labelled], u[labelled], border[labelled]
        points = depth[v + 1, u + 1, None] * directions[v + 1, u + 1]
        seen = self.visible(views, number, points, points[:, 2])
        return PointLabels(points[seen], np.flatnonzero(border[seen]))

    def noise_levels(self, distance: float) -> dict[NoiseKind, float]:
        """Return the noise of depths, which grows with the distance, and of the border, a pixel's angle."""
        depth = range_noise(self.noise + self.noise_growth * distance**2)
        return {"range": depth, "depth_border": float(1 / self.camera.fx / np.sqrt(12))}

    def draw(
        self, message: Mapping[str, Any], labels: Sequence[Mapping[str, Any]], patterns: Sequence[Pattern], files: Path
    ) -> Image:
        """Draw the image, near bright and far dark; the labelled pixels in their colours."""
        camera = self.camera
        width = max(1, round(PICTURE_HEIGHT_PX / camera.height * camera.width))
        try:
            depth = read_depth_image(files / message["data_file"], camera).depth
        except InputError:
            return blank(width)
        rows, columns = (
            np.arange(n) * size // n for n, size in ((PICTURE_HEIGHT_PX, camera.height), (width, camera.width))
        )
        picture = _colour_depths(depth[rows[:, None], columns])
        for label in labels:
            for key, colour, size in (("idxs", ON_PATTERN, 3), ("idxs_limit_points", ON_BORDER, 1)):
                y, x = np.divmod(np.array(label[key], int), camera.width)
                marked = np.zeros((PICTURE_HEIGHT_PX, width), np.uint8)
                marked[y * PICTURE_HEIGHT_PX // camera.height, x * width // camera.width] = 1
                picture[cv2.dilate(marked, np.ones((size, size), np.uint8)) > 0] = colour  # labels are thinned
        return picture


def _colour_depths(depth: DepthImage) -> Image:
    """Colour depths (h, w) from near to far (h, w, 3); dark without a return. Integer arithmetic."""
    returned = (depth != NO_RETURN) & (depth != 0)
    sorted_depths = np.sort(depth[returned].astype(int))
    if not len(sorted_depths):
        return np.full((*depth.shape, 3), NO_DATA_COLOUR, np.uint8)
    near, far = sorted_depths[[len(sorted_depths) // 100, -1 - len(sorted_depths) // 100]]
    share = 255 * (np.clip(depth, near, far) - near) // max(far - near, 1)
    return np.where(returned[..., None], _FROM_NEAR[share], np.array(NO_DATA_COLOUR, np.uint8))
