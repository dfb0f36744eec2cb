"""Lens models: one object each, with its names in ROS and Kalibr, its coefficients, its projection and the inverse.

A new one is a class of `Distortion` in this package and its place in `MODELS`; the recipe "A lens" in CONTRIBUTING.md
names the few other places that know models by name.
"""

from calibration.engine.geometry.lenses.model import LAST_STEP, Distortion
from calibration.engine.geometry.lenses.pinhole import PlumbBob, Rational
from calibration.engine.geometry.lenses.wide import DoubleSphere, Equidistant, Eucm, Omni

MODELS: dict[str, type[Distortion]] = {
    model.ros_name: model for model in (PlumbBob, Equidistant, Eucm, DoubleSphere, Rational, Omni)
}
"""Models by the name in ROS; those that come first are preferred, if they fit as well as each other."""
SYNONYMS = {name: model.ros_name for model in MODELS.values() for name in model.synonyms}
"""What drivers and tools call them too."""

__all__ = [
    "LAST_STEP",
    "MODELS",
    "SYNONYMS",
    "Distortion",
    "DoubleSphere",
    "Equidistant",
    "Eucm",
    "Omni",
    "PlumbBob",
    "Rational",
]
