"""Calibrated lags: the truth is found with its error bar, and what is not determined is an error."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError, UndeterminedError
from calibration.base.arrays import Array
from calibration.engine.dataset.document import Node
from calibration.engine.dataset.frames import read_velocities
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import FILE_NAME, read_dataset
from calibration.engine.dataset.writing import DatasetWriter
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.suspects import explain
from calibration.engine.estimation.options import ALL_EXACT
from calibration.engine.geometry.transforms import inverse, local, retract
from tests.engine.estimation.scenes import Scene, board, camera, looks, pose
from tests.engine.estimation.systems import stereo

T2RGB = Path(__file__).resolve().parents[3] / "datasets" / "t2rgb"
LAG, N = 0.03, 24
HAND = ("world", "hand")
MOUNT = camera("cam", "hand").edge


def moving(seed: int = 0) -> Array:
    """Velocities (N, 6)."""
    return np.random.default_rng(seed).normal(size=(N, 6)) * [0.1, 0.1, 0.1, 0.3, 0.3, 0.3]


def arm(lag: float = LAG) -> tuple[Dataset, Array]:
    """A camera on a hand that moves while it looks at a board in the world; and the true mount."""
    T_mount, T_board, own = (
        pose(0.05, -0.03, 0.1, 0.1, 0.2, -1.4),
        pose(0.8, 0.2, 0.1, 0.2, -0.1, 0.5),
        board(fixed=True),
    )
    T_hand = T_board @ inverse(looks(N, 3, pattern=own)) @ inverse(T_mount)
    mounted = replace(camera("cam", "hand"), calibration_parent="hand")
    seen = Scene(
        transforms={HAND: retract(T_hand, lag * moving()), MOUNT: T_mount, (own.parent_link, own.link): T_board},
        sensors=[mounted],
        patterns=[own],
        pixel_noise=0.2,
    ).dataset(5)
    return replace(seen.with_transforms({HAND: T_hand}), velocities={HAND: moving()}), T_mount


@pytest.mark.parametrize("lag", [-0.04, 0.0, LAG])
def test_the_lag_of_a_camera_on_a_moving_arm_is_found_with_its_error_bar(lag: float) -> None:
    dataset, T_mount = arm(lag)
    found = calibrate(dataset, Options(lag=("free",), assume=ALL_EXACT))
    assert found.lags.keys() == {"cam"}
    assert found.lags["cam"].seconds == pytest.approx(lag, abs=3 * found.lags["cam"].sigma)
    assert found.lags["cam"].sigma < 1e-3
    error = local(found.transforms[MOUNT], T_mount)
    assert error @ np.linalg.solve(found.covariances[MOUNT], error) < 22.5  # chi^2 of 6 at 1 in 1000
    assert found.dataset.sensors["cam"].lag == found.lags["cam"].seconds


def test_a_lag_that_is_not_free_is_a_suspect_in_seconds_and_its_error_bar_widens_the_others() -> None:
    dataset, _ = arm()
    held = calibrate(dataset, Options(assume=ALL_EXACT))
    explanation = explain(held.solution.model)
    assert explanation is not None
    (suspect,) = explanation.suspects
    assert (suspect.cause.kind, suspect.cause.unit) == ("lag", "s")
    assert suspect.value[0] == pytest.approx(LAG, rel=0.1)
    exact, _ = arm(0.0)
    fixed, free = (calibrate(exact, Options(lag=lag, assume=ALL_EXACT)) for lag in ((), ("cam",)))
    assert free.label_sigma_mm(MOUNT) > fixed.label_sigma_mm(MOUNT)


def test_what_does_not_move_does_not_determine_a_lag() -> None:
    dataset, _ = arm(0.0)
    with pytest.raises(UndeterminedError, match="has no velocities"):
        calibrate(replace(dataset, velocities={}), Options(lag=("cam",)))
    with pytest.raises(UndeterminedError, match="do not determine the lag of 'cam'"):
        calibrate(replace(dataset, velocities={HAND: 1e-6 * moving()}), Options(lag=("free",)))
    with pytest.raises(InputError, match="found sensor 'nobody', expected of cam"):
        calibrate(dataset, Options(lag=("nobody",)))


def test_between_two_cameras_one_is_the_clock_and_a_board_that_moves_tells_the_lag_of_the_other() -> None:
    scene = stereo(N, pixel_noise=0.2)
    own = scene.patterns[0]
    edge = (own.parent_link, own.link)
    names = [sensor.name for sensor in scene.sensors]
    on_time = scene.dataset(1)
    late = replace(scene, transforms={**scene.transforms, edge: retract(scene.transforms[edge], LAG * moving())})
    later = late.dataset(1)
    collections = tuple(
        replace(c, labels={key: (d if key[1] == names[1] else c).labels[key] for key in c.labels})
        for c, d in zip(on_time.collections, later.collections, strict=True)
    )
    dataset = replace(on_time, collections=collections, velocities={edge: moving()}, anchored=names[0])
    found = calibrate(dataset, Options(lag=("free",), assume=ALL_EXACT)).lags
    assert found.keys() == {names[1]}
    assert found[names[1]].seconds == pytest.approx(LAG, abs=3 * found[names[1]].sigma)
    assert found[names[1]].sigma < 1e-3
    with pytest.raises(UndeterminedError, match=f"leave '{names[0]}' the clock"):
        calibrate(dataset, Options(lag=tuple(names), assume=ALL_EXACT))


def test_a_lag_is_written_with_the_dataset_and_read_again(tmp_path: Path) -> None:
    dataset = read_dataset(T2RGB)
    edge = next(iter(dataset.transforms))
    document = json.loads((T2RGB / FILE_NAME).read_text())
    for collection in document["collections"].values():
        collection["velocities"] = {
            "-".join(edge): {"parent": edge[0], "child": edge[1], "twist": [0.1, 0, 0, 0, 0, 0.2]}
        }
    (tmp_path / FILE_NAME).write_text(json.dumps(document))
    given = read_dataset(tmp_path)
    name = next(iter(given.sensors))
    for full in (True, False):
        path = tmp_path / str(full) / FILE_NAME
        path.parent.mkdir()
        writer = DatasetWriter(given)
        path.write_text((writer.text if full else writer.changes_text)(given.with_lags({name: 0.02})))
        again = read_dataset(path, given=tmp_path)
        assert again.sensors[name].lag == 0.02
        np.testing.assert_array_equal(again.velocities[edge], given.velocities[edge])
        steps = local(given.transforms[edge], again.seen_by(name).transforms[edge])
        np.testing.assert_allclose(steps, np.tile([2e-3, 0, 0, 0, 0, 4e-3], (len(steps), 1)), atol=1e-12)


@pytest.mark.parametrize(
    ("entry", "fault"),
    [
        ({"parent": "a", "child": "c", "twist": [0] * 6}, "found parent 'a' and child 'c'"),
        ({"parent": "a", "child": "b", "twist": [0] * 5}, "expected 6 numbers"),
        ({"parent": "a", "child": "b", "twist": [1e9, 0, 0, 0, 0, 0]}, "collections/000/velocities/a-b/twist/0"),
        ({"parent": "a", "child": "b"}, "twist"),
    ],
)
def test_bad_velocities_name_the_place(entry: dict[str, object], fault: str) -> None:
    node = Node(Path("dataset.json"), ("collections", "000"), {"velocities": {"a-b": entry}})
    with pytest.raises(InputError, match=fault):
        read_velocities([node])
