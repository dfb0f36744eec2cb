"""Checks of calibrated intrinsics: how sure the projection is; of a camera alone whether its residuals are noise."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from calibration.base.arrays import Array
from calibration.engine.diagnosis.finding import Finding, Severity
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.precision import BETTER_OF_CAMERAS, MIN_DISAGREEMENT, wider
from calibration.engine.estimation.covariance.projection import Projection, projection_of
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.geometry.cameras import Camera

DEFAULT_RELATIVE_LIMIT = 0.004
"""Default limit of a camera alone, of the image's longer side: a focal length that is 0.8 % off moves its border so."""
ENOUGH_VIEWS = 10
"""Views of a pattern, below which their number is the reason why a projection is not sure."""
MIN_TILT = 15.0
"""Degrees between a pattern and the image plane: if nine views of ten have less, none is tilted, and the focal length
and the distance make up for each other."""
WELL_SEEN = 0.4
"""Share of the image with corners below which a warning says where there are none."""
MIN_FAILING_NOISE = 1.0
"""px: noise of the corners from which it is a failure: three times what a good detector keeps in sharp images."""
NAMES_OF_IMAGE_PARTS = ("left", "middle", "right"), ("top", "centre", "bottom")


def projection(calibration: Calibration, limits: Limits) -> tuple[Finding, ...]:
    """Report cameras whose projection is not sure enough for the limit, or unknown in much of the image.

    Without a limit of the user only cameras alone are judged, by the default one.

    Args:
        calibration: a calibration that has converged.
        limits: limits that the user has set.
    """
    if limits.projection_px is None and not calibration.of_cameras_alone:
        return ()
    return tuple(each for name in calibration.intrinsics for each in _of_camera(calibration, limits, name))


def projection_limit(camera: Camera, limits: Limits) -> float:
    """Return the limit of a camera's projection error, px: the user's, or the default."""
    return (
        DEFAULT_RELATIVE_LIMIT * max(camera.width, camera.height)
        if limits.projection_px is None
        else limits.projection_px
    )


def _of_camera(calibration: Calibration, limits: Limits, name: str) -> Iterator[Finding]:
    found, covariance = projection_of(calibration, name), calibration.intrinsics[name].covariance
    sigmas = np.where(found.seen, found.sigmas(covariance, found.distance), np.nan)
    sigma, limit = found.most(sigmas), projection_limit(found.camera, limits)
    views = len(found.normals)
    if not limits.guard * sigma <= limit:
        where = _part_of_image(sigmas)
        yield Finding(
            "too-few" if views < ENOUGH_VIEWS else "precision",
            "undecided",
            f"the projection of '{name}' is not determined well enough: {sigma:.2g} px (standard deviation, in all, "
            f"{found.distance:.2g} m away, at most in nine tenths of the image where the pattern was seen), limit "
            f"{limit:.3g} px with a guard band of {limits.guard:g} standard deviations; "
            f"{_advise_remedy(calibration, found, name, where)}",
            (name,),
            value=sigma,
            unit="px",
        )
    share = float(found.seen.mean())
    if share < WELL_SEEN and views >= ENOUGH_VIEWS:
        text = (
            f"'{name}' has seen corners in {share:.0%} of its image: where it has none, the lens is not known; bring "
            f"the pattern to all borders and corners of the image"
        )
        yield Finding("coverage", "warning", text, (name,), value=share, unit="1")


def _advise_remedy(calibration: Calibration, found: Projection, name: str, where: str) -> str:
    """Return advice on the largest contribution to the standard deviation."""
    views = len(found.normals)
    if views < ENOUGH_VIEWS:
        return f"{views} views are too few: take {BETTER_OF_CAMERAS}"
    tilt = float(np.quantile(_tilts_of_patterns(found.normals), 0.9))
    if tilt < MIN_TILT:
        return (
            f"the pattern faces the camera in all views (tilted by {tilt:.0f} degrees at most), so that the focal "
            f"length and the distance make up for each other: add views that are tilted by 30 to 45 degrees"
        )
    setup, bars = calibration.solution.setup, calibration.error_bars
    block = next(i for i, b in enumerate(setup.problem.blocks) if b.intrinsics and b.intrinsics.sensor == name)
    if bars is not None and wider(bars.total[block], bars.expected[block]) > MIN_DISAGREEMENT:
        return (
            "the views disagree by more than their corners' noise: a pattern that is not flat or that bends, images "
            "that were taken in motion, or a lens with more than its model"
        )
    if bars is not None and wider(bars.expected[block], bars.labels[block]) > MIN_DISAGREEMENT:
        return (
            "most of it is what is assumed of the pattern: use one on glass or aluminium, and state how flat it is "
            "under 'assume' (flatness, pattern-stretch)"
        )
    return f"add views with the pattern near, tilted by 30 to 45 degrees, and at the {where} of the image"


def _tilts_of_patterns(normals: Array) -> Array:
    """Return the angle (V,) between each pattern and the image plane, degrees."""
    tilts: Array = np.degrees(np.arccos(np.clip(np.abs(normals[:, 2]), 0, 1)))
    return tilts


def _part_of_image(sigmas: Array) -> str:
    """Return where in the image the largest of values (R, C) is, in words: "top left", "centre"."""
    row, column = np.unravel_index(int(np.nanargmax(sigmas)), sigmas.shape)
    across, down = (
        names[int(at * 3 // size)]
        for names, at, size in zip(NAMES_OF_IMAGE_PARTS, (column, row), sigmas.shape[::-1], strict=True)
    )
    return " ".join(each for each in (down, across) if each not in ("centre", "middle")) or "centre"


def of_cameras_alone(calibration: Calibration, limits: Limits, findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return notes on the residuals as warnings, or failures: of a camera alone nothing else says what it is worth."""
    return tuple(
        replace(each, severity=_severity_of_finding(calibration, limits, each))
        if each.severity == "note" and each.kind in ("residual-pattern", "noisy-sensor")
        else each
        for each in findings
    )


def _severity_of_finding(calibration: Calibration, limits: Limits, finding: Finding) -> Severity:
    camera = calibration.dataset.sensors[finding.sensors[0]].camera
    value = finding.value or 0.0
    if finding.kind == "noisy-sensor":
        return "red" if finding.unit == "px" and value > MIN_FAILING_NOISE else "warning"
    return "red" if camera is not None and value > projection_limit(camera, limits) else "warning"


def shifts(calibration: Calibration, moves: Array) -> Mapping[str, float]:
    """Return by how much changes (S,) of the parameters shift the projection of each calibrated camera, px."""
    problem = calibration.solution.setup.problem
    return {
        intrinsics.sensor: projection_of(calibration, intrinsics.sensor).shift(moves[at])
        for block, at in problem.shared_parameters.items()
        if (intrinsics := problem.blocks[block].intrinsics) is not None
    }
