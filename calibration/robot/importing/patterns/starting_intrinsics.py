"""Initial guess of unknown intrinsics, and their lens model, from the corners of all views of one camera."""

from collections.abc import Sequence

from calibration.base.errors import UndeterminedError
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels
from calibration.engine.estimation.start.chosen_lenses import fitting_lens
from calibration.engine.estimation.start.lens_choice import SIMPLEST_FIRST, LensChoice
from calibration.engine.geometry.lenses import MODELS

LEAST_VIEWS = 5
"""Minimum of views: fewer views of a plane do not determine the intrinsics."""
MOST_VIEWS = 60
"""Limit of views: more do not improve the initial guess."""


def starting_intrinsics(
    sensor: str,
    size: tuple[int, int],
    views: Sequence[tuple[PatternConfiguration, CornerLabels]],
    model: str | None = None,
) -> LensChoice:
    """Fit intrinsics to the corners, of the simplest lens model that fits.

    Args:
        sensor: the camera, for messages.
        size: of its images, width and height.
        views: corners of which pattern, by view.
        model: the lens model, where it is chosen.

    Raises:
        UndeterminedError: there are too few views.
        InputError: no lens fits them.
    """
    if len(views) < LEAST_VIEWS:
        raise UndeterminedError(
            f"'{sensor}' has no intrinsics, and {len(views)} images with a pattern to calibrate them from; expected "
            f"{LEAST_VIEWS} or more, or a file: intrinsics"
        )
    some = views[:: -(-len(views) // MOST_VIEWS)]
    patterns = {id(pattern): pattern.pattern() for pattern, _ in some}
    models = SIMPLEST_FIRST if model is None else (MODELS[model],)
    return fitting_lens(f"'{sensor}'", *size, [(patterns[id(pattern)], labels) for pattern, labels in some], models)
