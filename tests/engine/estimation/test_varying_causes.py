"""What is another one in each collection is named with its size, and tells how far off the result is."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.what_does_not_fit import what_does_not_fit
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.cluster_state import ClusterState
from calibration.engine.estimation.covariance.fixed_inputs import PLACE_KIND
from calibration.engine.estimation.covariance.varying_causes import _Variation, steadied
from calibration.engine.estimation.options import ALL_EXACT
from calibration.engine.geometry.transforms import apply, distance, retract, translation
from tests.engine.estimation import systems
from tests.engine.estimation.scenes import relabelled

CAMERA = ("world", "cam")
SCENE = systems.eye_to_hand(24, pixel_noise=0.1)
GOOD = SCENE.dataset()


def shifted(size: float) -> Dataset:
    """Images that are shifted one by one, px."""
    shifts = np.random.default_rng(1).normal(0, size, (24, 2))

    def moved(i: int, _: str, labels: Labels) -> Labels:
        assert isinstance(labels, CornerLabels)
        return replace(labels, pixels=labels.pixels + shifts[i])

    return relabelled(GOOD, moved)


def rolled(size: float) -> Dataset:
    """Images of a camera that moves while they are read row by row, m an image."""
    moves = np.random.default_rng(1).normal(0, size, (24, 3))
    camera, [pattern] = GOOD.sensors["cam"].camera, GOOD.patterns.values()
    assert camera
    T = GOOD.transform("cam", pattern.link)

    def seen(i: int, ids: Array, share: float) -> Array:
        return camera.project(apply(translation(share * moves[i]) @ T[i], pattern.corners[ids]))

    def read(i: int, _: str, labels: Labels) -> Labels:
        assert isinstance(labels, CornerLabels)
        row = labels.pixels[:, 1:] / camera.height - 0.5
        return replace(labels, pixels=labels.pixels + row * (seen(i, labels.ids, 0.5) - seen(i, labels.ids, -0.5)))

    return relabelled(GOOD, read)


@pytest.mark.parametrize(
    ("dataset", "name", "size"),
    [(shifted(2.0), "principal point of cam", 2.0), (rolled(0.005), "motion while an image is read of cam", 0.005)],
    ids=["shifted", "rolled"],
)
def test_what_varies_is_named_and_tells_how_far_off_the_result_is(dataset: Dataset, name: str, size: float) -> None:
    calibration = calibrate(dataset)
    varying = calibration.solution.varying
    assert varying is not None
    assert varying.causes[0].name == name
    assert varying.sigmas == pytest.approx(size, rel=0.4)
    own = calibration.solution.setup.problem.shared_parameters[calibration.solution.setup.block(CAMERA)]
    found, truth = calibration.transforms[CAMERA], GOOD.transforms[CAMERA][0]
    off, left = (distance(T, truth)[0] for T in (found, retract(found, varying.change[own])))
    assert left < 0.6 * off
    assert left < 4 * np.sqrt(np.trace(varying.covariance[own, own][:3, :3]))


def test_a_result_that_is_off_by_what_varies_is_red() -> None:
    calibration = calibrate(shifted(2.0))
    for limit, severity in ((0.05, "red"), (20.0, "note")):
        [said] = what_does_not_fit(calibration, Limits(translation_mm=limit))
        assert (said.kind, said.severity) == ("contradiction", severity)
        assert "as cam's principal point or " in said.text


def test_nothing_varies_where_collections_agree() -> None:
    assert calibrate(GOOD, Options(assume=ALL_EXACT)).solution.varying is None


def test_a_board_of_another_size_on_an_arm_that_is_off_in_each_pose_is_no_row_of_moves() -> None:
    """The arm's errors look like moves in the midst of the recording, and there are several of them."""
    scene = systems.eye_to_hand(20, pixel_noise=0.5)
    errors = np.random.default_rng(4).normal(0, (0.0004,) * 3 + (0.0015,) * 3, (20, 6))
    edge = ("base", "flange")
    dataset = replace(scene, transforms={**scene.transforms, edge: retract(scene.transforms[edge], errors)}).dataset()
    [(name, pattern)] = dataset.patterns.items()
    wrong = replace(dataset, patterns={name: replace(pattern, corners=1.045 * pattern.corners)})
    explanation = calibrate(wrong).solution.explanation
    assert explanation is not None
    kinds = [each.cause.kind for each in explanation.suspects]
    assert kinds[0] in ("size", "lengths")
    assert PLACE_KIND not in kinds
    model = calibrate(wrong).solution.model
    place = next(cause for cause, _ in model.placed() if cause.kind == PLACE_KIND)
    move = replace(explanation.suspects[0], cause=place, since=8)
    steady = steadied(model, replace(explanation, suspects=(move, move)))
    assert steady
    assert [each.cause.kind for each in steady.suspects][:1] == kinds[:1]


def test_what_varies_without_bound_leaves_its_own_mean_undetermined() -> None:
    model = calibrate(GOOD, Options(assume=ALL_EXACT)).solution.model
    cause, at = next((cause, at) for cause, at in model.placed() if cause.kind == PLACE_KIND)
    found = _Variation.first(ClusterState.at_optimum(model), cause, at)
    assert found
    assert np.isfinite(found.deviance)
    assert replace(found, variances=found.variances * 1e30).deviance == np.inf
