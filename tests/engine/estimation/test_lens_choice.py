"""Lens models of cameras without intrinsics: the simplest that fits, never a pinhole for a fisheye."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.base import InputError
from calibration.base.records import read
from calibration.engine.dataset.model import ESTIMATED_KEY, CornerLabels, Dataset
from calibration.engine.dataset.pattern import Pattern
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import Options
from calibration.engine.estimation.start.lens_choice import LensChoice, fitting_lens, with_chosen_lenses
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.lenses import Distortion, DoubleSphere, Equidistant, PlumbBob, Rational
from calibration.engine.geometry.transforms import apply, transform
from tests.engine.estimation.scenes import board
from tests.engine.estimation.systems import covering

ALL = Options(intrinsics=("all",))
FISHEYE = Camera(560.0, 557.0, 641.0, 477.0, 1280, 960, Equidistant(-0.02, 0.01, -0.003, 0.001))
WIDE_RATIONAL = Camera(420.0, 415.0, 645.0, 475.0, 1280, 960, Rational(9.0, 5.6, 0.0004, -0.0003, 0.3, 9.3, 8.6, 1.8))


def views_of(dataset: Dataset) -> list[tuple[Pattern, CornerLabels]]:
    return [
        (dataset.patterns[pattern], labels)
        for collection in dataset.collections
        for (pattern, _), labels in collection.labels.items()
        if isinstance(labels, CornerLabels)
    ]


def chosen(model: Camera, views: int = 25, seed: int = 0, noise: float = 0.2) -> LensChoice:
    dataset = covering(views, seed, 1, model=model, pixel_noise=noise).dataset(seed)
    return fitting_lens("c0", model.width, model.height, views_of(dataset))


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize(
    ("model", "expected", "seed"),
    [
        (Camera(800.0, 790.0, 640.0, 480.0, 1280, 960), PlumbBob, 0),
        (Camera(700.0, 690.0, 650.0, 470.0, 1280, 960, PlumbBob(-0.3, 0.12, 0.001, -0.0005, -0.02)), PlumbBob, 3),
        (FISHEYE, Equidistant, 0),
        (FISHEYE, Equidistant, 3),
        (WIDE_RATIONAL, Rational, 3),
    ],
)
def test_the_simplest_model_that_fits_is_chosen(model: Camera, expected: type[Distortion], seed: int) -> None:
    choice = chosen(model, seed=seed)
    assert type(choice.chosen.camera.distortion) is expected, choice.reason
    assert choice.chosen.rms == pytest.approx(0.2 * np.sqrt(2), rel=0.15)
    assert choice.chosen.camera.fx == pytest.approx(model.fx, rel=0.02)
    assert choice.reason.startswith(expected.ros_name)


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("lens", [Equidistant(-0.02, 0.01, -0.003, 0.0005), DoubleSphere(-0.2, 0.59)], ids=str)
def test_a_lens_of_195_degrees_is_found(lens: Distortion) -> None:
    model = Camera(270.0, 271.0, 640.0, 478.0, 1280, 960, lens)
    random = np.random.default_rng(1)
    rays = model.rays(random.uniform((60, 60), (1220, 900), (200, 2)))
    rays = rays[rays[:, 2] > np.cos(np.radians(97.5))][:40]
    assert np.count_nonzero(rays[:, 2] < 0) > 2
    pattern = board()
    R = rotations.towards(rays) @ rotations.exp(random.uniform(-0.5, 0.5, (40, 3)))
    T = transform(R, 0.7 * rays - R @ pattern.centre)
    noise = random.normal(0, 0.2, (40, len(pattern.corners), 2))
    views = [
        (pattern, CornerLabels(np.arange(len(pattern.corners)), model.project(apply(T[i], pattern.corners)) + noise[i]))
        for i in range(40)
    ]
    choice = fitting_lens("c0", 1280, 960, views)
    assert choice is not None
    assert choice.chosen.rms == pytest.approx(0.2 * np.sqrt(2), rel=0.1), choice.reason
    named = fitting_lens("c0", 1280, 960, views, (type(lens),))
    assert named is not None
    assert named.chosen.camera.fx == pytest.approx(270.0, rel=0.01)
    assert named.chosen.camera.distortion.coefficients == pytest.approx(lens.coefficients, abs=0.01)


def test_the_start_is_found_for_every_field_of_view() -> None:
    for f in (300.0, 600.0, 1200.0, 3000.0):
        model = Camera(f, f, 640.0, 480.0, 1280, 960)
        choice = fitting_lens(
            "c0", 1280, 960, views_of(covering(25, 0, 1, model=model, pixel_noise=0.05).dataset()), (PlumbBob,)
        )
        assert choice is not None
        assert choice.chosen.camera.fx == pytest.approx(f, rel=0.03)


def test_the_guess_of_plumb_bob_has_no_k3_so_that_it_can_be_held_at_zero() -> None:
    choice = chosen(Camera(700.0, 690.0, 650.0, 470.0, 1280, 960, PlumbBob(-0.3, 0.12, 0.001, -0.0005, -0.02)))
    assert choice.guess.distortion.coefficients[4] == 0
    assert choice.chosen.camera.distortion.coefficients[4] != 0


def test_one_bad_view_does_not_choose_the_model() -> None:
    dataset = covering(25, 3, 1, pixel_noise=0.2).dataset(3)
    views = views_of(dataset)
    pattern, labels = views[4]
    blurred = labels.pixels + np.random.default_rng(0).normal(0, 3, labels.pixels.shape)
    views[4] = pattern, CornerLabels(labels.ids, blurred)
    choice = fitting_lens("c0", 1280, 960, views)
    assert choice is not None
    assert choice.chosen.name == "plumb_bob"


def test_corners_that_no_lens_explains_are_refused_with_what_to_do() -> None:
    views = views_of(covering(6, 0, 1).dataset())
    rng = np.random.default_rng(1)
    noise = [(p, CornerLabels(v.ids, rng.uniform(0, 900, v.pixels.shape))) for p, v in views]
    with pytest.raises(InputError, match=r"'front': no lens model fits its corners.*are the patterns as described"):
        fitting_lens("'front'", 1280, 960, noise)


def guessed(dataset: Dataset, *cameras: str) -> Dataset:
    """A dataset as an import leaves it: pinholes in the place of the true lenses."""
    pinhole = Camera(400.0, 400.0, 640.0, 480.0, 1280, 960, PlumbBob(-0.2, 0.03))
    named = replace(dataset, document={"_metadata": {ESTIMATED_KEY: list(cameras)}})
    return named.with_cameras(dict.fromkeys(cameras, pinhole))


def test_a_fisheye_without_intrinsics_is_calibrated_as_one() -> None:
    dataset = guessed(covering(25, 2, 1, model=FISHEYE, pixel_noise=0.2).dataset(2), "c0")
    lenses = with_chosen_lenses(dataset, ALL)
    assert lenses.choices["c0"].chosen.name == "equidistant"
    result = calibrate(lenses.dataset, ALL)
    found = result.intrinsics["c0"]
    assert result.converged
    assert found.model == "equidistant"
    assert (np.abs(found.values - FISHEYE.intrinsics) < 4 * found.sigmas).all()


def test_only_cameras_whose_intrinsics_are_guessed_and_calibrated_are_chosen() -> None:
    dataset = covering(15, 2, 2, model=FISHEYE, pixel_noise=0.2).dataset(2)
    half = guessed(dataset, "c1")
    lenses = with_chosen_lenses(half, ALL)
    assert set(lenses.choices) == {"c1"}
    assert lenses.dataset.sensors["c0"].camera == FISHEYE
    assert with_chosen_lenses(half, Options()).dataset is half


def test_a_named_model_is_taken_and_nothing_is_chosen() -> None:
    dataset = covering(15, 2, 1, model=FISHEYE, pixel_noise=0.2).dataset(2)
    lenses = with_chosen_lenses(dataset, Options(intrinsics=("c0",), lens={"c0": "rational_polynomial"}))
    camera = lenses.dataset.sensors["c0"].camera
    assert camera is not None
    assert isinstance(camera.distortion, Rational)
    assert not lenses.choices
    with pytest.raises(InputError, match="lens: found 'c7', expected a camera"):
        with_chosen_lenses(dataset, Options(intrinsics=("all",), lens={"c7": "equidistant"}))


def test_the_library_takes_the_lens_of_the_options_too() -> None:
    dataset = covering(15, 2, 1, model=FISHEYE, pixel_noise=0.2).dataset(2)
    options = Options(intrinsics=("c0",), lens={"c0": "equidistant"})
    result = calibrate(guessed(dataset, "c0"), options)
    assert result.intrinsics["c0"].model == "equidistant"
    with pytest.raises(InputError, match="lens: found 'c7', expected a camera"):
        calibrate(dataset, Options(intrinsics=("all",), lens={"c7": "equidistant"}))


def test_the_options_take_all_as_a_word_and_refuse_a_lens_that_is_not_calibrated() -> None:
    assert read(Options, {"intrinsics": "all"}, "calibration.yml").intrinsics == ("all",)
    assert read(Options, {"intrinsics": ["left"]}, "calibration.yml").intrinsics == ("left",)
    with pytest.raises(InputError, match="intrinsics: found 'left', expected"):
        read(Options, {"intrinsics": "left"}, "calibration.yml")
    with pytest.raises(InputError, match="lens: found 'left', whose intrinsics are not calibrated"):
        read(Options, {"lens": {"left": "equidistant"}}, "calibration.yml")
    with pytest.raises(InputError, match=r"lens\.left: found 'fisheye', expected"):
        read(Options, {"intrinsics": "all", "lens": {"left": "fisheye"}}, "calibration.yml")


def test_corners_that_are_not_seen_do_not_count() -> None:
    """Their pixels are no labels: those of an image's corner would be 98 degrees off the axis of this fisheye."""
    model = Camera(300.0, 301.0, 421.0, 302.0, 848, 600, Equidistant(-0.012, 0.045, -0.036, 0.006))
    dataset = covering(20, 0, 1, model=model, pixel_noise=0.1).dataset(0)
    partial = [
        (pattern, CornerLabels(labels.ids[k % 9 :], labels.pixels[k % 9 :]))
        for k, (pattern, labels) in enumerate(views_of(dataset))
    ]
    choice = fitting_lens("c0", 848, 600, partial)
    assert choice is not None
    assert choice.chosen.name == "equidistant", choice.reason
    assert choice.chosen.camera.fx == pytest.approx(300, abs=2)
