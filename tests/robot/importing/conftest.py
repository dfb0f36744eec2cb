"""Folders of images with an import.yml, from the datasets that ship."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from calibration.robot.labelling.detection import Image
from calibration.robot.labelling.markers import MarkerFinder, Markers

DATASETS = Path(__file__).resolve().parents[3] / "datasets"
DESCRIPTION = Path(__file__).with_name("import.yml")
BOARD = yaml.safe_load(DESCRIPTION.read_text())["patterns"]["board"]
CAMERAS = ("left_camera", "right_camera")
FOCAL = 554.256258422

Write = Callable[..., Path]


def camera_info(
    width: int = 640, height: int = 480, focal: float = FOCAL, centre: tuple[float, float] = (320.5, 240.5)
) -> dict[str, Any]:
    """The document of a camera_info file."""
    K = [focal, 0, centre[0], 0, focal, centre[1], 0, 0, 1]
    return {
        "image_width": width,
        "image_height": height,
        "camera_matrix": {"rows": 3, "cols": 3, "data": K},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
    }


@pytest.fixture
def stereo(tmp_path: Path) -> Path:
    """The folder of an import: six images of each of t2rgb's cameras, ``import.yml``, ``camera.yaml``."""
    folder = tmp_path / "recorded"
    for camera in CAMERAS:
        (folder / camera).mkdir(parents=True)
        for number in range(6):
            shutil.copy(DATASETS / "t2rgb" / f"{camera}_{number:03d}.jpg", folder / camera / f"{number}.jpg")
    (folder / "camera.yaml").write_text(yaml.safe_dump(camera_info()))
    shutil.copy(DESCRIPTION, folder)
    return folder


def change(folder: Path, *keys: str, to: Any) -> None:
    """Set a key of import.yml; None removes it."""
    file = folder / "import.yml"
    document = yaml.safe_load(file.read_text())
    *way, last = keys
    place = document
    for key in way:
        place = place[key]
    if to is None:
        place.pop(last)
    else:
        place[last] = to
    file.write_text(json.dumps(document))


_FOUND: dict[tuple[object, ...], Markers] = {}


@pytest.fixture(autouse=True)
def an_image_is_searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Markers are searched once in an image, as most tests import the same ones; the search is labelling's to test."""

    def remembering(search: Callable[..., Markers]) -> Callable[..., Markers]:
        def searched(finder: MarkerFinder, image: Image, *box: Any) -> Markers:
            pixels = hashlib.blake2b(np.ascontiguousarray(image), digest_size=16).digest()
            plain = finder._plain
            how = plain.getDetectorParameters()
            wanted = (plain.getDictionary().bytesList.tobytes(), finder._first, finder._count)
            key = (*wanted, how.markerBorderBits, how.errorCorrectionRate, search.__name__, image.shape, pixels, *box)
            if key not in _FOUND:
                _FOUND[key] = search(finder, image, *box)
            return _FOUND[key]

        return searched

    for name in ("find", "find_small"):
        monkeypatch.setattr(MarkerFinder, name, remembering(getattr(MarkerFinder, name)))
