"""Figures of the poses to take next: over the cameras' images, and in space."""

from base64 import b64encode
from collections.abc import Iterator
from typing import TYPE_CHECKING

from calibration.ci.pages.charts import drawing, text
from calibration.ci.pages.html import Html, element, figure, join
from calibration.ci.pages.image_figures import FIGURE_WIDTH
from calibration.engine.dataset.model import Dataset
from calibration.pipeline.matrix.next_poses_result import NextPoses
from calibration.pipeline.page.in_space import in_space
from calibration.pipeline.page.label_residuals import view_jpeg

if TYPE_CHECKING:
    from calibration.pipeline.next_poses import AdvisedPoses


def pose_figures(advised: "AdvisedPoses", given: Dataset | None = None) -> Html:
    """Return the poses over the image of each camera, and in space.

    Args:
        advised: the poses.
        given: the recording, for an image of each camera.
    """
    dataset = advised.candidates.dataset
    over_images = poses_in_images(advised.found, dataset, given)
    space = in_space(dataset.with_collections(advised.chosen), None) if advised.chosen else Html("")
    return join([over_images, space])


def poses_in_images(found: NextPoses, dataset: Dataset, given: Dataset | None) -> Html:
    """Return a figure for each camera: the outlines of the boards at the poses, with their numbers."""
    figures = [
        figure(
            poses_in_image(found, name, (sensor.camera.width, sensor.camera.height), given),
            f"Where the board goes in the image of {name}, pose by pose.",
        )
        for name, sensor in dataset.sensors.items()
        if sensor.camera is not None and any(view.camera == name for pose in found.poses for view in pose.views)
    ]
    return element("div", *figures, class_="figures") if figures else Html("")


def poses_in_image(found: NextPoses, camera: str, size: tuple[int, int], given: Dataset | None) -> Html:
    """Return the outlines of the boards at the poses, with their numbers, over an image of a camera if there is one."""
    scale = FIGURE_WIDTH / size[0]
    height = size[1] * scale
    jpeg = next((image for key in given.keys if (image := view_jpeg(given, camera, key))), None) if given else None
    address = f"data:image/jpeg;base64,{b64encode(jpeg).decode('ascii')}" if jpeg else ""
    picture = element("image", href=address, width=FIGURE_WIDTH, height=height, opacity=0.5) if jpeg else Html("")
    frame = element("rect", x=0.5, y=0.5, width=FIGURE_WIDTH - 1, height=height - 1, class_="frame")
    return drawing(FIGURE_WIDTH, height, f"Poses before {camera}", picture, frame, *_numbered(found, camera, scale))


def _numbered(found: NextPoses, camera: str, scale: float) -> Iterator[Html]:
    for number, pose in enumerate(found.poses, 1):
        for view in (each for each in pose.views if each.camera == camera):
            points = [(scale * u, scale * v) for u, v in view.outline]
            path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points) + "Z"
            yield element("path", d=path, class_="scene pattern")
            x, y = (sum(axis) / len(points) for axis in zip(*points, strict=True))
            yield text(x, y, str(number), class_="label")
