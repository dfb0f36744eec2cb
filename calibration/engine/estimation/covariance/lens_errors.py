"""Errors of a held camera's intrinsics: as given with them, else as of a nominal calibration, as `assume` scales it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.dataset.lens_uncertainty import LensUncertainty
from calibration.engine.estimation.covariance.nominal_lens import nominal_lens
from calibration.engine.estimation.problem.assumptions import ALL_EXACT, OF_INTRINSICS, Assumptions
from calibration.engine.estimation.problem.intrinsics import PARAMETERS_IN_PIXELS, Prior
from calibration.engine.geometry.cameras import Camera

LensSource = Literal["nominal", "assume", "covariance", "standard-deviations"]


@dataclass(frozen=True, eq=False)
class LensErrors:
    """Independent errors of standard deviation 1, and what each does to the intrinsics."""

    parameters: tuple[str, ...]
    """n of `Camera.parameters`."""
    root: Array
    """(n, k): ``root root^T`` is the covariance of the parameters."""
    source: LensSource
    is_exact: bool = False
    """Whether all of them are exactly known; the root is then of a nominal calibration."""


def lens_errors(camera: Camera, assume: Assumptions, given: Prior | LensUncertainty | None) -> LensErrors:
    """Return the errors of a camera's intrinsics.

    Args:
        camera: the camera.
        assume: what the user states of it: with 0 a parameter is exactly known, and the others are as well known as
            that makes them; a standard deviation above 0 scales all errors, by the largest ratio of one that is stated
            to the nominal one.
        given: what its own calibration says, and counts instead: the covariance that the user has given, or what
            the dataset has, unless all is assumed to be exact. Standard deviations alone are taken as those of the
            nominal calibration's corners, all in one ratio; its board stays as it is.
    """
    if isinstance(given, Prior):
        return _of_covariance(tuple(camera.parameters[i] for i in given.at), given.covariance)
    nominal = nominal_lens(camera)
    if given is not None and assume != ALL_EXACT:
        if given.covariance is not None:
            return _of_covariance(given.parameters, given.covariance)
        common = [name for name in nominal.parameters if name in given.parameters]
        stated = given.sigmas[[given.parameters.index(name) for name in common]]
        usual = np.linalg.norm(nominal.by_noise[[nominal.parameters.index(name) for name in common]], axis=1)
        ratio = float(np.exp(np.log(stated / usual).mean())) if common else 1.0
        root = np.concatenate([ratio * nominal.by_noise, nominal.by_flatness], 1)
        return LensErrors(nominal.parameters, root, "standard-deviations")
    root = np.concatenate([nominal.by_noise, nominal.by_flatness], 1)
    assumed = {name: value for name in OF_INTRINSICS if (value := getattr(assume, name)) is not None}
    source: LensSource = "assume" if assumed else "nominal"
    if len(assumed) == len(OF_INTRINSICS) and not any(assumed.values()):
        return LensErrors(nominal.parameters, root, source, is_exact=True)
    combinations = _combinations_of_assumptions(camera, nominal.parameters)
    known = [combinations[name] @ root for name, value in assumed.items() if not value]
    if known:  # what is left of independent errors if these combinations of them are 0
        Q, _ = np.linalg.qr(np.concatenate(known).T)
        root = root - root @ Q @ Q.T
    scales = [_ratio_of_sigmas(value, combinations[name] @ root) for name, value in assumed.items() if value]
    return LensErrors(nominal.parameters, max(scales, default=1.0) * root, source)


def _of_covariance(parameters: tuple[str, ...], covariance: Array) -> LensErrors:
    s = np.sqrt(np.diagonal(covariance))
    root = s[:, None] * np.linalg.cholesky(covariance / s[:, None] / s)
    return LensErrors(parameters, root, "covariance")


def _ratio_of_sigmas(stated: float, effects: Array) -> float:
    """Return a stated standard deviation over the first of those that errors (m, k) have."""
    return float(stated / np.linalg.norm(effects[0]))


def _combinations_of_assumptions(camera: Camera, parameters: tuple[str, ...]) -> dict[str, Array]:
    """Return what each assumption is about, as combinations (m, n) of the parameters."""
    unit = dict(zip(parameters, np.eye(len(parameters)), strict=True))
    fx, fy = unit["fx"] / camera.fx, unit["fy"] / camera.fy
    return {
        "focal_length": ((fx + fy) / 2)[None],
        "aspect": (fx - fy)[None],
        "principal_point": np.stack([unit["cx"], unit["cy"]]),
        "distortion": np.stack([unit[name] for name in parameters if name not in PARAMETERS_IN_PIXELS]),
    }
