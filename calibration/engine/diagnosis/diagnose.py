"""Checks of a calibration that need no ground truth, in the order of the report."""

from calibration.engine.dataset.model import Dataset
from calibration.engine.diagnosis.camera_info import camera_info
from calibration.engine.diagnosis.conventions.trying import conventions, doubts
from calibration.engine.diagnosis.description import FAR_AWAY, far_from_description
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.missing_files import missing_files
from calibration.engine.diagnosis.precision import precision
from calibration.engine.diagnosis.projection import of_cameras_alone, projection
from calibration.engine.diagnosis.rejected_labels import rejected_labels
from calibration.engine.diagnosis.repeated import repeated
from calibration.engine.diagnosis.residuals import residuals
from calibration.engine.diagnosis.too_few import too_few
from calibration.engine.diagnosis.turned_boards import turned_boards
from calibration.engine.diagnosis.what_does_not_fit import NOTHING_SUSPICIOUS, UNTESTED, what_does_not_fit
from calibration.engine.diagnosis.wrong_views import wrong_views
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.solve.options import Options

KINDS_WITHOUT_SUSPECTS = (NOTHING_SUSPICIOUS, UNTESTED)
"""Findings on a calibration without suspects."""


def diagnose(
    calibration: Calibration, description: Dataset, options: Options, limits: Limits, truth_known: bool = False
) -> tuple[Finding, ...]:
    """Run all checks of a calibration and return their findings.

    Args:
        calibration: the result.
        description: the dataset with the robot's description, without the noise of an initial guess.
        options: options of the calibration.
        limits: limits of its errors.
        truth_known: whether it is also compared with ground truth, which measures its error.
    """
    found = _as_it_is(calibration, description, options, limits, truth_known)
    if doubts(calibration, found) and (named := conventions(calibration, description, options)):
        return (*missing_files(calibration.dataset), *named)  # all else is its consequence
    return found


def _as_it_is(
    calibration: Calibration, description: Dataset, options: Options, limits: Limits, truth_known: bool
) -> tuple[Finding, ...]:
    """Run all checks of a calibration of the recording as it was read."""
    if not calibration.converged:
        return (
            *missing_files(calibration.dataset),
            *wrong_views(calibration),
            *_said_by_the_engine(calibration),
        )
    far, rejected = far_from_description(calibration, description, options), rejected_labels(calibration, limits)
    explained = any(each.kind != FAR_AWAY for each in far)  # a single cause is reported instead of its consequences
    suspected = what_does_not_fit(calibration, limits)
    return (
        *missing_files(calibration.dataset),
        *_not_determined(calibration),
        *turned_boards(calibration),
        *(far if explained else ()),
        *(each for each in suspected if each.severity == "red"),
        *wrong_views(calibration, limits),
        *(each for each in suspected if each.severity != "red"),
        *_of_residuals(calibration, limits, suspected),
        *(() if truth_known else (*too_few(calibration), *precision(calibration, limits, suspected))),
        *projection(calibration, limits),
        *(() if explained else far),
        *rejected,
        *repeated(calibration),
        *camera_info(calibration),
        *_said_by_the_engine(calibration),
    )


def _of_residuals(calibration: Calibration, limits: Limits, suspected: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """Report residuals that are no noise, if nothing else explains them."""
    if calibration.of_cameras_alone:
        return of_cameras_alone(calibration, limits, residuals(calibration))
    return residuals(calibration) if all(each.kind in KINDS_WITHOUT_SUSPECTS for each in suspected) else ()


def _not_determined(calibration: Calibration) -> tuple[Finding, ...]:
    """Report what is left out of the result because the data do not determine it."""
    if not calibration.not_determined:
        return ()
    text = (
        f"only the poses of the sensors relative to each other are calibrated, from what they see together; where they "
        f"are on the robot is not: '{calibration.gauge}' is held where the robot's description puts it, for "
        f"{calibration.not_determined}"
    )
    return (Finding("not-determined", "warning", text),)


def _said_by_the_engine(calibration: Calibration) -> tuple[Finding, ...]:
    """Report warnings of the least-squares solver."""
    return (
        *(Finding("contradicted-prior", "warning", text) for text in calibration.warnings),
        *(Finding("weak-direction", "note", f"weakly determined: {text}") for text in calibration.weak_directions),
        *(Finding("engine", "note", text) for text in calibration.notes),
    )
