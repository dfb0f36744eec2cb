"""Packages that only some of the work needs: imported at their first use, as they are slow, or not installed."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from calibration.base.errors import InfrastructureError

PACKAGE_OF_MODULE = {
    "av": ("PyAV", "av"),
    "boto3": ("boto3", "'calibration-ci[aws]'"),
    "coverage": ("coverage", "'calibration-ci[coverage]'"),
    "cv2": ("OpenCV", "opencv-python-headless"),
    "docker": ("docker", "'calibration-ci[containers]'"),
    "hpl": ("hpl-specs", "'calibration-ci[requirements]'"),
    "pyarrow": ("pyarrow", "'calibration-ci[lerobot]'"),
    "yaml": ("PyYAML", "pyyaml"),
    "rosbags": ("rosbags", "'calibration-ci[bags]'"),
    "websockets": ("websockets", "'calibration-ci[requirements]'"),
}
"""Name of a package, and what pip installs, where they differ from its module."""


def optional(module: str, user: str) -> Any:
    """Import a module.

    Args:
        module: its name, such as "matplotlib.figure".
        user: what needs it, for the message: "the figure".

    Raises:
        InfrastructureError: its package is not installed.
    """
    package = module.partition(".")[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        name, source = PACKAGE_OF_MODULE.get(package, (package, package))
        raise InfrastructureError(f"{user} needs {name}: pip install {source}") from None


@contextmanager
def figures_of_matplotlib(font_size: int) -> Iterator[Any]:
    """Yield ``matplotlib.figure``, in a style by which the same data give the same bytes on every machine.

    Raises:
        InfrastructureError: matplotlib is not installed.
    """
    style = {
        "font.size": font_size,
        "font.family": ["DejaVu Sans"],  # bundled with matplotlib: the same picture on every machine
        "text.parse_math": False,  # names come from the user and may contain $
        "svg.hashsalt": "calibration-ci",
        "svg.fonttype": "path",
    }
    figures, rc_context = optional("matplotlib.figure", "the figure"), optional("matplotlib", "the figure").rc_context
    with rc_context(style), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name in a script that the font lacks
        yield figures
