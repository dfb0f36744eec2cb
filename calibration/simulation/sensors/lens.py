"""The lens of a camera or a depth camera, as ``simulation.yml`` describes it."""

import math

from calibration.dataset.document import Node
from calibration.geometry.cameras import Camera
from calibration.geometry.distortion import MODELS, Distortion, Equidistant, PlumbBob
from calibration.simulation.description import number, numbers, whole

MAX_PIXELS = 25_000_000
"""Of one image: beyond it memory runs out."""
LENS = ("width", "height", "hfov_deg", "principal_point", "K", "distortion_model", "distortion")
"""The keys of a description that `read_lens` reads."""


def read_lens(node: Node) -> Camera:
    """Read the keys in `LENS`: ``hfov_deg`` with ``principal_point`` if it is not Gazebo's, or ``K``.

    Raises:
        InputError: a key is missing, or its value out of range.
    """
    width, height = whole(node, "width", 2, 100_000), whole(node, "height", 2, 100_000)
    if width * height > MAX_PIXELS:
        raise node["width"].fault(f"found {width} x {height} pixels, expected {MAX_PIXELS} at most")
    distortion = _read_distortion(node)
    if node.get("K"):
        fx, fy, cx, cy = _intrinsics(node)
    else:
        half = math.radians(number(node, "hfov_deg", least=1, most=170)) / 2
        fx = fy = width / 2 / (half if isinstance(distortion, Equidistant) else math.tan(half))
        # Gazebo's principal point, and so that of ATOM's systems
        cx, cy = numbers(node, "principal_point", 2, (width / 2 + 0.5, height / 2 + 0.5))
    return Camera(fx, fy, cx, cy, width, height, distortion)


def _read_distortion(node: Node) -> Distortion:
    name = node.get("distortion_model")
    if name and name.text() not in MODELS:
        raise name.unexpected(f"one of {', '.join(MODELS)}")
    model = MODELS[name.value] if name else PlumbBob
    count = len(model.names())
    return model(*numbers(node, "distortion", count, (0.0,) * count))


def _intrinsics(node: Node) -> tuple[float, float, float, float]:
    for other in ("hfov_deg", "principal_point"):
        if node.get(other):
            raise node[other].fault("stands beside K, which says the same; give one of them")
    fx, skew, cx, zero, fy, cy, *last = numbers(node, "K", 9)
    if min(fx, fy) <= 0 or skew or zero or last != [0, 0, 1]:
        raise node["K"].fault("expected [fx, 0, cx, 0, fy, cy, 0, 0, 1] with fx and fy above 0")
    return fx, fy, cx, cy
