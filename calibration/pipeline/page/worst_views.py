"""Part of the page: the images with the largest residuals, with their corners."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from calibration.base.arrays import Array
from calibration.base.errors import CalibrationError
from calibration.base.optional import optional
from calibration.ci.pages.html import Html, element
from calibration.ci.pages.overlay import overlay
from calibration.ci.pages.page import figure
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.payload import locate
from calibration.engine.evaluation.residuals import Residuals

SHOWN = 4
PIXELS = 640
"""Width of an image in the page; larger ones are reduced."""
QUALITY = 70
"""Quality of its JPEG, percent."""
JPEG, SMALL = b"\xff\xd8\xff", 64_000
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
    views = [(float(value), i, name) for name, each in rms.items() for i, value in enumerate(each) if value == value]
    worst = sorted(views, reverse=True)[:SHOWN]
    figures = [_figure(dataset, found[name], name, i, value, given) for value, i, name in worst]
    if figures:
        yield element("h3", "The views that fit worst")
        yield element("div", *figures, class_="figures")


def _figure(dataset: Dataset, found: Residuals, name: str, i: int, rms: float, given: Dataset | None) -> Html:
    key, camera = dataset.keys[i], dataset.sensors[name].camera
    size = (camera.width, camera.height) if camera else (1, 1)
    own = found.collections == i
    seen = found.where[own]
    title = f"{name} in collection {key}: RMS {rms:.3g} px"
    drawn = overlay(title, _jpeg(given, name, key), size, seen, seen + found.values[own])
    return figure(drawn, f"{title}. Crosses: where corners were seen; circles: where they come out.")


def _jpeg(given: Dataset | None, name: str, key: str) -> bytes | None:
    """Return the image of a view, reduced; None if it is not available, or OpenCV is needed and not installed."""
    if given is None:
        return None
    try:
        path = Path(locate(Node(given.path, (), given.document)["collections"][key]["data"][name]["data_file"]))
        if not path.is_file():
            return None
        if path.stat().st_size <= SMALL and (data := path.read_bytes()).startswith(JPEG):
            return data
        cv2 = optional("cv2", "a smaller image")
        from calibration.robot.importing.patterns.image_views import read_image  # imports OpenCV

        image: Any = read_image(path)
    except (OSError, CalibrationError):
        return None
    scale = min(1.0, PIXELS / image.shape[1])
    size = max(1, round(scale * image.shape[1])), max(1, round(scale * image.shape[0]))
    smaller = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    done, encoded = cv2.imencode(".jpg", smaller, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return bytes(encoded) if done else None
