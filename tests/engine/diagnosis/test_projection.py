"""Calibrated intrinsics: a projection that is not sure, too few or untilted views, residuals that are no noise."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from calibration.base import UndeterminedError
from calibration.engine.dataset.model import Collection, CornerLabels, Dataset
from calibration.engine.diagnosis.diagnose import diagnose
from calibration.engine.diagnosis.finding import Finding
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import Options
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Equidistant, PlumbBob
from calibration.engine.geometry.transforms import transform
from tests.engine.estimation.systems import covering

ALL = Options(intrinsics=("all",))
LENS = Camera(600.0, 590.0, 640.0, 480.0, 1280, 960, PlumbBob(-0.10, 0.05, 0.001, -0.0005, 0.01))


def tilted(most: float, views: int = 25) -> Dataset:
    """Views of a pattern that is tilted by up to this, rad."""
    scene = covering(views, 0, 1, model=LENS, pixel_noise=0.2)
    (pattern,) = scene.patterns
    T = scene.transforms["world", "board_link"]
    centre = T[:, :3, :3] @ pattern.centre + T[:, :3, 3]
    R = rotations.exp(np.random.default_rng(0).uniform(-most, most, (views, 3)))
    placed = scene.transforms["world", "c0"] @ transform(R, centre - R @ pattern.centre)
    return replace(scene, transforms={**scene.transforms, ("world", "board_link"): placed}).dataset(0)


def found(dataset: Dataset, limits: Limits | None = None) -> Sequence[Finding]:
    result = calibrate(dataset, ALL)
    return diagnose(result, dataset, ALL, limits or Limits())


def of(findings: Sequence[Finding], *kinds: str) -> list[Finding]:
    return [each for each in findings if each.kind in kinds]


def test_a_good_recording_has_nothing_to_say() -> None:
    assert not [each for each in found(tilted(0.5)) if each.severity != "note"]


def test_a_limit_that_error_bars_reach_over_is_undecided_and_says_where_to_put_the_pattern() -> None:
    (finding,) = of(found(tilted(0.5), Limits(projection_px=0.1)), "precision")
    assert finding.severity == "undecided"
    assert finding.sensors == ("c0",)
    assert finding.value is not None
    assert 0.05 < finding.value < 2
    assert "limit 0.1 px" in finding.text


def test_views_without_tilt_are_named_as_the_reason() -> None:
    (finding,) = of(found(tilted(0.05)), "precision")
    assert "tilted by 3 degrees at most" in finding.text
    assert finding.severity == "undecided"
    with pytest.raises(UndeterminedError, match=r"'intrinsics-c0' \(fx, fy.*tilted by 30 to 45 degrees"):
        calibrate(tilted(0.0), ALL)


def test_too_few_views_are_named_as_the_reason() -> None:
    (finding,) = of(found(tilted(0.5, views=6), Limits(projection_px=0.1)), "too-few")
    assert finding.severity == "undecided"
    assert "6 views are too few: take 20 to 40" in finding.text


def test_a_wrong_lens_model_is_not_noise() -> None:
    fisheye = Camera(560.0, 557.0, 640.0, 480.0, 1280, 960, Equidistant(0.05, 0.02, -0.003, 0.001))
    dataset = covering(40, 1, 1, model=fisheye, pixel_noise=0.1).dataset(1)
    held = Options(intrinsics=("all",), hold=("intrinsics-c0-k2", "intrinsics-c0-k3"))
    wrong = dataset.with_cameras({"c0": replace(LENS, distortion=PlumbBob())})
    result = calibrate(wrong, held)
    assert [each for each in diagnose(result, wrong, held, Limits()) if each.severity in ("red", "warning")]


def noisy(dataset: Dataset, sigma: float) -> Dataset:
    rng = np.random.default_rng(3)
    collections = [
        Collection(
            c.key,
            {
                key: CornerLabels(v.ids, v.pixels + rng.normal(0, sigma, v.pixels.shape))
                for key, v in c.labels.items()
                if isinstance(v, CornerLabels)
            },
        )
        for c in dataset.collections
    ]
    return replace(dataset, collections=tuple(collections))


@pytest.mark.parametrize(("sigma", "severity"), [(0.5, "warning"), (1.3, "red")])
def test_corners_that_scatter_more_than_a_detector_errs(sigma: float, severity: str) -> None:
    (finding,) = of(found(noisy(tilted(0.5), sigma)), "noisy-sensor")
    assert finding.severity == severity
    assert finding.unit == "px"


def test_a_lens_that_was_seen_in_a_corner_only_is_a_warning() -> None:
    dataset = tilted(0.5, views=40)
    left = [i for i, c in enumerate(dataset.collections) if _is_left(c)]
    (finding,) = of(found(dataset.with_collections(left)), "coverage")
    assert finding.severity == "warning"
    assert "of its image" in finding.text


def _is_left(collection: Collection) -> bool:
    (labels,) = collection.labels.values()
    return isinstance(labels, CornerLabels) and bool(labels.pixels[:, 0].mean() < 500)


def test_rigs_are_judged_by_a_limit_of_the_user_only() -> None:
    dataset = covering(15, 0, 2, model=LENS, pixel_noise=0.2).dataset(0)
    assert not of(found(dataset), "coverage")
    names = {each.sensors for each in of(found(dataset, Limits(projection_px=0.01)), "precision")}
    assert {("c0",), ("c1",)} <= names
