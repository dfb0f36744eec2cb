"""Parts of the page about labels: residuals over the image, their distribution, worst views, cameras, next poses."""

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.base import CalibrationError
from calibration.base.arrays import Array
from calibration.base.optional import optional
from calibration.ci.pages.charts import drawing, heat_map, histogram, text
from calibration.ci.pages.figures import CORNER_STEPS, FIGURE_WIDTH, image_map, overlay, residual_plane
from calibration.ci.pages.html import Html, element, figure, join
from calibration.engine.dataset.document import Node, locate
from calibration.engine.dataset.model import Dataset, Sensor
from calibration.engine.estimation.covariance.lens_errors import LensSource
from calibration.engine.estimation.covariance.projection import cells_with_pixels
from calibration.engine.estimation.least_squares.noise_levels import NoiseLevels
from calibration.engine.evaluation.label_errors import Residuals, residuals
from calibration.engine.geometry.cameras import Camera
from calibration.pipeline.matrix.cell_result import ProjectionResult
from calibration.pipeline.matrix.next_poses_result import NextPoses
from calibration.pipeline.page.in_space import in_space

MAX_VIEWS = 4
IMAGE_WIDTH = 640
"""Width of an image in the page; larger ones are reduced."""
JPEG_QUALITY = 70
"""Quality of its JPEG, percent."""
JPEG_MAGIC, MAX_UNCHANGED_BYTES = b"\xff\xd8\xff", 64_000
"""First bytes of a JPEG; and the size up to which it is embedded unchanged."""


def worst_views(
    dataset: Dataset, found: Mapping[str, Residuals], rms: Mapping[str, Array], given: Dataset | None
) -> Iterator[Html]:
    """Yield figures of the views with the largest RMS.

    Args:
        dataset: calibrated.
        found: residuals of the cameras.
        rms: (N,) of each, by collection; NaN for no view.
        given: the given dataset, with its images, if available.
    """
    views = [
        (float(value), i, name)
        for name, by_collection in rms.items()
        for i, value in enumerate(by_collection)
        if value == value
    ]
    worst = sorted(views, reverse=True)[:MAX_VIEWS]
    figures = [_view_figure(dataset, found[name], name, i, value, given) for value, i, name in worst]
    if figures:
        yield element("h3", "The views that fit worst")
        yield element("div", *figures, class_="figures")


def _view_figure(dataset: Dataset, of_camera: Residuals, name: str, i: int, rms: float, given: Dataset | None) -> Html:
    key, camera = dataset.keys[i], dataset.sensors[name].camera
    size = (camera.width, camera.height) if camera else (1, 1)
    in_view = of_camera.collections == i
    seen = of_camera.where[in_view]
    title = f"{name} in collection {key}: RMS {rms:.3g} px"
    drawn = overlay(title, view_jpeg(given, name, key), size, seen, seen + of_camera.values[in_view])
    return figure(drawn, f"{title}. Crosses: where corners were seen; circles: where they come out.")


def view_jpeg(given: Dataset | None, name: str, key: str) -> bytes | None:
    """Return the image of a view, reduced; None if it is not available, or OpenCV is needed and not installed."""
    if given is None:
        return None
    try:
        path = Path(locate(Node(given.path, (), given.document)["collections"][key]["data"][name]["data_file"]))
    except (OSError, CalibrationError):
        return None
    return reduced_jpeg(path)


def reduced_jpeg(path: Path) -> bytes | None:
    """Return an image, reduced; None if it is not available, or OpenCV is needed and not installed."""
    try:
        if not path.is_file():
            return None
        if path.stat().st_size <= MAX_UNCHANGED_BYTES and (data := path.read_bytes()).startswith(JPEG_MAGIC):
            return data
        cv2 = optional("cv2", "a smaller image")
        from calibration.robot.importing.image_views import read_image  # imports OpenCV

        image: Any = read_image(path)
    except (OSError, CalibrationError):
        return None
    scale = min(1.0, IMAGE_WIDTH / image.shape[1])
    size = max(1, round(scale * image.shape[1])), max(1, round(scale * image.shape[0]))
    smaller = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    is_encoded, encoded = cv2.imencode(".jpg", smaller, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return bytes(encoded) if is_encoded else None


_PLANE_CAPTION = (
    "from where its corners were seen to where they come out, enlarged. Red ones are longer than three times the RMS. "
    "Where the image is empty, the lens is not known."
)


def residuals_by_sensor(dataset: Dataset) -> dict[str, Residuals]:
    """Return the residuals of each sensor that has labels."""
    found = {name: residuals(dataset, sensor) for name, sensor in dataset.sensors.items()}
    return {name: of_sensor for name, of_sensor in found.items() if len(of_sensor.collections)}


def label_residuals(
    dataset: Dataset, by_sensor: Mapping[str, Residuals], levels: NoiseLevels | None, given: Dataset | None = None
) -> Iterator[Html]:
    """Yield the figures of each sensor that has labels, then the views' RMS.

    Args:
        dataset: calibrated.
        by_sensor: its residuals, by sensor.
        levels: the calibration's estimate of the labels' standard deviations.
        given: the given dataset, with its images, if available.
    """
    if by_sensor:
        yield element("h3", "Residuals")
    for name, of_sensor in by_sensor.items():
        yield element("div", *_residual_figures(dataset.sensors[name], of_sensor, levels), class_="figures")
    pixels: dict[str, Array] = {}
    for unit, factor, widths in (("px", 1.0, (2,)), ("mm", 1e3, (1, 3))):
        rows = [name for name, of_sensor in by_sensor.items() if of_sensor.values.shape[-1] in widths]
        if rows:
            by_view = {name: factor * _by_collection(by_sensor[name], len(dataset.collections)) for name in rows}
            drawn = heat_map("RMS of each view", rows, dataset.keys, np.array(list(by_view.values())), unit)
            yield figure(drawn, f"RMS of each view, {unit}: the stronger, the larger; empty where nothing was seen.")
            if unit == "px":
                pixels = by_view
    yield from worst_views(dataset, by_sensor, pixels, given)


def _residual_figures(sensor: Sensor, of_sensor: Residuals, levels: NoiseLevels | None) -> Iterator[Html]:
    stated = "beside the normal distribution of the noise that the calibration states."
    if sensor.camera is not None and of_sensor.values.shape[-1] == 2:
        size = sensor.camera.width, sensor.camera.height
        yield figure(
            residual_plane(sensor.name, size, of_sensor.where, of_sensor.values), f"{sensor.name}: {_PLANE_CAPTION}"
        )
        yield from _maps_over_image(sensor.name, sensor.camera, of_sensor)
        sigma = levels.pixel if levels else None
        drawn = histogram(f"{sensor.name}, x and y", of_sensor.values.ravel(), sigma or 0.0, "px")
        yield figure(drawn, f"{sensor.name}: residuals in x and y {stated}")
    elif sensor.modality.has_poses:
        sigma = levels.pose_translation if levels else None
        drawn = histogram(f"{sensor.name}, x, y and z", 1e3 * of_sensor.values.ravel(), 1e3 * (sigma or 0.0), "mm")
        yield figure(drawn, f"{sensor.name}: from where patterns were measured to where they come out {stated}")
    else:
        sigma = levels.range if levels else None
        drawn = histogram(sensor.name, 1e3 * of_sensor.values.ravel(), 1e3 * (sigma or 0.0), "mm")
        yield figure(drawn, f"{sensor.name}: distances from the pattern {stated}")


def _maps_over_image(name: str, camera: Camera, found: Residuals) -> Iterator[Html]:
    """Yield the maps of how many corners were seen in each part of the image, and of how well they fit there."""
    size = camera.width, camera.height
    count = cells_with_pixels(camera, found.where)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(cells_with_pixels(camera, found.where, found.sizes**2) / count)
    coverage = image_map(f"Coverage of {name}", size, np.where(count > 0, count, np.nan), "corners", CORNER_STEPS)
    views, share = len(np.unique(found.collections)), np.mean(count > 0)
    yield figure(
        coverage, f"{name}: corners seen in each part of the image, in {views} views; {share:.0%} of it has some."
    )
    yield figure(
        image_map(f"Residuals of {name}", size, rms), f"{name}: RMS of the residuals in each part of the image."
    )


def _by_collection(of_sensor: Residuals, count: int) -> Array:
    """RMS (count,) of each view; NaN if there is none."""
    sums = np.bincount(of_sensor.collections, of_sensor.sizes**2, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        rms: Array = np.sqrt(sums / np.bincount(of_sensor.collections, minlength=count))
    return rms


_GIVEN_INTRINSICS: Mapping[LensSource, str] = {
    "nominal": "given intrinsics as sure as a usual calibration's",
    "assume": "given intrinsics as sure as assume says",
    "covariance": "given intrinsics and their covariance",
    "standard-deviations": "given intrinsics and their standard deviations",
}


def projection_figures(cameras: Sequence[ProjectionResult]) -> Iterator[Html]:
    """Yield the maps of each camera, for points at the pattern's distance and far away."""
    if cameras:
        yield element("h3", "How sure the projection is")
    for camera in cameras:
        size = camera.width, camera.height
        near = image_map(
            f"Projection of {camera.camera}, {camera.distance_m:.2g} m away", size, _cell_values(camera, camera.near_px)
        )
        far = image_map(f"Projection of {camera.camera}, far away", size, _cell_values(camera, camera.far_px))
        what = f"{camera.camera}: standard deviation of where a point is seen"
        what += f", with {_GIVEN_INTRINSICS[camera.given]}," if camera.given else ""
        yield element(
            "div",
            figure(
                near,
                f"{what} at the pattern's distance, {camera.distance_m:.2g} m: {camera.median_px:.2g} px (median), "
                f"{camera.worst_px:.2g} px at most where corners were seen, in {camera.seen:.0%} of the image.",
            ),
            figure(far, f"{what} far away: {camera.far_median_px:.2g} px, {camera.far_worst_px:.2g} px at most."),
            class_="figures",
        )


def _cell_values(projection: ProjectionResult, values: Sequence[float]) -> Array:
    """Return the values (R, C) of the cells; NaN where the lens has no ray."""
    cells = np.array(values).reshape(-1, projection.columns)
    return np.where(cells > 0, cells, np.nan)


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


def poses_in_images(
    found: NextPoses, dataset: Dataset, given: Dataset | None, images: Mapping[str, bytes | None] | None = None
) -> Html:
    """Return a figure for each camera: the outlines of the boards at the poses, with their numbers.

    Args:
        found: the poses.
        dataset: the robot's cameras.
        given: the recording, for an image of each camera.
        images: these images, JPEG, by camera, where there is no recording yet.
    """
    figures = [
        figure(
            poses_in_image(found, name, (sensor.camera.width, sensor.camera.height), given, (images or {}).get(name)),
            f"Where the board goes in the image of {name}, pose by pose.",
        )
        for name, sensor in dataset.sensors.items()
        if sensor.camera is not None and any(view.camera == name for pose in found.poses for view in pose.views)
    ]
    return element("div", *figures, class_="figures") if figures else Html("")


def poses_in_image(
    found: NextPoses, camera: str, size: tuple[int, int], given: Dataset | None, jpeg: bytes | None = None
) -> Html:
    """Return the outlines of the boards at the poses, with their numbers, over an image of a camera if there is one."""
    scale = FIGURE_WIDTH / size[0]
    height = size[1] * scale
    if given is not None:
        jpeg = next((image for key in given.keys if (image := view_jpeg(given, camera, key))), None)
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
