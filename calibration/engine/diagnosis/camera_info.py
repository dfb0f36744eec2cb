"""Note of what the error bars take held intrinsics to be known by."""

from calibration.engine.diagnosis.finding import Finding
from calibration.engine.estimation.covariance.fixed_inputs import CAMERA_INFO
from calibration.engine.estimation.covariance.lens_errors import LensSource
from calibration.engine.estimation.covariance.nominal_lens import NUMBER_OF_VIEWS
from calibration.engine.estimation.covariance.result import Calibration

KNOWN_BY: dict[LensSource, str] = {
    "nominal": f"as from a nominal calibration of {NUMBER_OF_VIEWS} views; one of your own may leave its covariance "
    "(intrinsics-covariance)",
    "assume": "as 'assume' says",
    "covariance": "by the covariance of its own calibration",
    "standard-deviations": "by the standard deviations in its file",
}


def camera_info(calibration: Calibration) -> tuple[Finding, ...]:
    """Report how well the camera_info of each camera is taken to be known; nothing where it is exact or calibrated."""
    known: dict[LensSource, list[str]] = {}
    for cause in calibration.solution.model.causes:
        if cause.kind == CAMERA_INFO and cause.known_by is not None and any(cause.assumed):
            known.setdefault(cause.known_by, []).append(cause.subject)
    return tuple(
        Finding("camera-info", "note", f"camera_info of {' and '.join(names)} is known {KNOWN_BY[source]}", (*names,))
        for source, names in known.items()
    )
