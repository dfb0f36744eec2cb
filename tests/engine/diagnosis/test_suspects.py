"""Parameters that do not fit are named with their deviation; those within their assumed error are not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Dataset, Labels, PointLabels
from calibration.engine.diagnosis.finding import Finding, Severity
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.rejected_labels import rejected_labels
from calibration.engine.diagnosis.what_does_not_fit import what_does_not_fit
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.fixed_inputs import PLACE_KIND
from calibration.engine.estimation.covariance.suspects import Disagreement, Explanation, Suspect, explain
from calibration.engine.estimation.least_squares.label_columns import ring_column
from calibration.engine.estimation.options import ALL_EXACT, Assumptions
from calibration.engine.estimation.residuals.ray_residuals import elevations
from calibration.engine.geometry import rotations
from calibration.engine.geometry.lenses import DoubleSphere
from calibration.engine.geometry.transforms import inverse, retract
from calibration.engine.statistics import median_of_norm
from tests.engine.estimation import scenes, systems
from tests.engine.estimation.scenes import relabelled

NOISE = 0.1
SUBJECTS = ("left", "right", "left and right")


def stereo(seed: int = 1) -> Dataset:
    return systems.stereo(24, seed=seed, pixel_noise=NOISE).dataset(seed)


def eye_to_hand(seed: int = 1) -> Dataset:
    return systems.eye_to_hand(24, seed=seed, pixel_noise=NOISE).dataset(seed)


def with_intrinsics(dataset: Dataset, sensor: str, change: Callable[[Array], None]) -> Dataset:
    """The dataset with another camera_info than the one that its images were made with."""
    camera = dataset.sensors[sensor].camera
    assert camera is not None
    values = camera.intrinsics
    change(values)
    return dataset.with_cameras({sensor: camera.with_intrinsics(values)})


def found(dataset: Dataset, assume: Assumptions = ALL_EXACT) -> tuple[Suspect, ...]:
    explanation = explain(calibrate(dataset, Options(assume=assume)).solution.model)
    assert explanation is not None
    return explanation.suspects


def findings(dataset: Dataset, limits: Limits | None = None, assume: Assumptions = ALL_EXACT) -> tuple[Finding, ...]:
    return what_does_not_fit(calibrate(dataset, Options(assume=assume)), limits or Limits())


@pytest.mark.parametrize("make", [stereo, eye_to_hand])
@pytest.mark.parametrize("assume", [ALL_EXACT, Assumptions()])
def test_nothing_is_suspicious_of_a_good_robot(make: Callable[[int], Dataset], assume: Assumptions) -> None:
    for seed in range(3):
        [finding] = findings(make(seed), assume=assume)
        assert (finding.kind, finding.severity) == ("nothing-suspicious", "note")
        assert "hangs most on the" in finding.text


def test_the_cause_that_moves_a_sensor_by_most_of_its_limits_is_said_first() -> None:
    def distorted(values: Array) -> None:
        values[4] += 0.08

    def longer(values: Array) -> None:
        values[:2] *= 1.01

    left, right = list((dataset := stereo()).sensors)
    wrong = with_intrinsics(with_intrinsics(dataset, left, distorted), right, longer)
    limits = Limits(translation_mm=0.05, rotation_deg=0.005)
    red = [each for each in findings(wrong, limits) if each.kind == "suspect" and each.severity == "red"]
    harm = [max((each.moves_mm or 0) / 0.05, (each.moves_deg or 0) / 0.005) for each in red]
    assert len(red) > 1
    assert harm == sorted(harm, reverse=True)


def test_a_focal_length_is_named_with_its_size_and_what_it_moves() -> None:
    def longer(values: Array) -> None:
        values[:2] *= 1.01

    dataset = stereo()
    name = list(dataset.sensors)[1]
    wrong = with_intrinsics(dataset, name, longer)
    suspect = found(wrong)[0]
    assert (suspect.cause.kind, suspect.cause.subject) == ("focal length", name)
    assert suspect.value[0] == pytest.approx(1 / 1.01 - 1, abs=5 * suspect.sigma[0] + 2e-4)
    finding = findings(wrong)[0]
    assert finding.severity == "red"
    assert finding.sensors == (name,)
    right, off = calibrate(dataset), calibrate(wrong)
    edge = dataset.sensors[name].edge
    moved = 1e3 * np.linalg.norm(right.transforms[edge][:3, 3] - off.transforms[edge][:3, 3])
    assert finding.moves_mm == pytest.approx(moved, rel=0.1)
    assert f"{name}'s focal length does not fit: off by -0.9" in finding.text


def test_what_moves_no_sensor_by_more_than_the_limit_is_a_note() -> None:
    def aside(values: Array) -> None:
        values[2] += 2

    dataset = stereo()
    name = list(dataset.sensors)[1]
    wrong = with_intrinsics(dataset, name, aside)
    [red, *_] = findings(wrong, Limits(translation_mm=0.1, rotation_deg=0.01))
    [note, *_] = findings(wrong, Limits(translation_mm=100, rotation_deg=10))
    assert (red.severity, note.severity) == ("red", "note")
    assert "principal point" in red.text
    assert "harmless" in note.text


def test_a_camera_info_of_another_camera_is_red_whatever_it_moves() -> None:
    def other(values: Array) -> None:
        values[:2] *= 1.05

    wrong = stereo()
    for name in wrong.sensors:
        wrong = with_intrinsics(wrong, name, other)
    [red, *_] = findings(wrong, Limits(translation_mm=1e4, rotation_deg=180))
    assert red.severity == "red"
    assert red.value == pytest.approx(1 / 1.05 - 1, abs=0.004)
    assert "left and right's focal length does not fit" in red.text
    assert "more than any camera errs" in red.text


def test_what_is_as_good_as_it_is_known_is_no_suspect() -> None:
    def slightly(values: Array) -> None:
        values[:2] *= 1.005

    dataset = stereo()
    wrong = with_intrinsics(dataset, list(dataset.sensors)[1], slightly)
    assert found(wrong, ALL_EXACT)
    assert not found(wrong, Assumptions(focal_length=0.004))


def test_a_wrong_pattern_size_is_named_if_an_arm_determines_it() -> None:
    dataset = eye_to_hand()
    (name,) = dataset.patterns
    pattern = dataset.patterns[name]
    larger = replace(dataset, patterns={name: replace(pattern, corners=pattern.corners * 1.01)})
    suspect = found(larger)[0]
    assert (suspect.cause.kind, suspect.cause.subject) == ("size", name)
    assert suspect.value[0] == pytest.approx(-0.0099, abs=0.001)


def test_two_causes_have_two_names() -> None:
    dataset = eye_to_hand()
    (name,) = dataset.patterns
    pattern = dataset.patterns[name]
    wrong = replace(dataset, patterns={name: replace(pattern, corners=pattern.corners * [1.02, 1.0, 1.0])})

    def longer(values: Array) -> None:
        values[:2] *= 1.02

    wrong = with_intrinsics(wrong, next(iter(dataset.sensors)), longer)
    assert {each.cause.kind for each in found(wrong)} == {"stretch along x", "focal length"}


def test_one_side_that_is_stretched_is_one_cause() -> None:
    dataset = eye_to_hand()
    (name,) = dataset.patterns
    pattern = dataset.patterns[name]
    wrong = replace(dataset, patterns={name: replace(pattern, corners=pattern.corners * [1.0, 1.01, 1.0])})
    [suspect] = found(wrong)
    assert (suspect.cause.kind, suspect.cause.subject) == ("stretch along y", name)
    assert suspect.value[0] == pytest.approx(-0.0099, abs=0.001)


def knocked(since: int, twist: tuple[float, ...]) -> Dataset:
    """An arm before a camera whose own frame is shifted and turned from a collection on."""
    dataset = eye_to_hand()
    (sensor,) = dataset.sensors.values()
    camera, pattern = sensor.camera, next(iter(dataset.patterns.values()))
    assert camera is not None
    collections = list(dataset.collections)
    T = dataset.transform(sensor.frame, pattern.link)
    for i in range(since, 24):
        after = np.linalg.inv(retract(np.eye(4), np.array(twist))) @ T[i]
        labels = {
            key: CornerLabels(label.ids, camera.project(pattern.corners[label.ids] @ after[:3, :3].T + after[:3, 3]))
            for key, label in collections[i].labels.items()
            if isinstance(label, CornerLabels)
        }
        collections[i] = replace(collections[i], labels=labels)
    return replace(dataset, collections=tuple(collections))


def test_a_sensor_that_has_moved_is_named_with_the_collection() -> None:
    dataset = knocked(12, (0.01, 0.0, 0.005, 0.0, 0.01, 0.0))
    [red, *_] = [f for f in findings(dataset) if f.severity == "red"]
    assert "has moved from collection" in red.text
    assert dataset.keys[12] in red.collections


def test_what_has_moved_late_is_as_far_off_as_it_stands_now() -> None:
    """The result is near to where it was; the robot as it is now is 5 mm from there."""
    limits = Limits(translation_mm=3, rotation_deg=1)
    red = next(each for each in findings(knocked(20, (0.005, 0, 0, 0, 0, 0)), limits) if each.kind == "suspect")
    assert red.severity == "red"
    assert red.moves_mm == pytest.approx(4.5, abs=0.8)
    assert "from where it is now (limit 3 mm, 1 deg)" in red.text


def test_another_board_from_some_collection_on_is_a_warning() -> None:
    """Its squares are 2 % larger; the result is within its limits all the same."""
    scene = systems.eye_to_hand(24, pixel_noise=NOISE)
    [board] = scene.patterns
    larger = replace(scene, patterns=[replace(board, corners=board.centre + 1.02 * (board.corners - board.centre))])
    dataset, other = scene.dataset(), larger.dataset()
    changed = replace(dataset, collections=(*dataset.collections[:16], *other.collections[16:]))
    calibration = calibrate(changed, Options(assume=Assumptions()))
    first, *_ = what_does_not_fit(calibration, Limits(translation_mm=20, rotation_deg=2))
    assert (first.severity, first.collections) == ("warning", changed.keys[16:])
    assert first.text.startswith("board's size has changed from collection 016 on")
    assert first.value == pytest.approx(0.02, abs=4 * (first.sigma or 0))
    assert not [each for each in rejected_labels(calibration, Limits()) if each.severity == "red"]


@pytest.mark.parametrize(("zoom", "severity"), [(1.01, "warning"), (1.04, "red")])
def test_a_zoom_while_recording_is_red_where_it_is_another_lens(zoom: float, severity: Severity) -> None:
    dataset = eye_to_hand()
    camera = dataset.sensors["cam"].camera
    assert camera is not None
    centre = np.array([camera.cx, camera.cy])

    def zoomed(i: int, _: str, label: Labels) -> Labels:
        assert isinstance(label, CornerLabels)
        return replace(label, pixels=(label.pixels - centre) * zoom + centre) if i >= 16 else label

    changed = relabelled(dataset, zoomed)
    first, *_ = findings(changed, Limits(translation_mm=100, rotation_deg=10), Assumptions())
    assert first.severity == severity
    assert first.text.startswith("cam's focal length has changed from collection 016 on")


def sagging(low: float, tilt: float) -> Dataset:
    """An arm whose end hangs lower by the square of its reach, m at 1 m, and is tilted by the reach, rad at 1 m."""
    scene = systems.eye_to_hand(24, pixel_noise=NOISE)
    T_world_base = scene.transforms["world", "base"]
    T_base_flange = scene.transforms["base", "flange"]
    T_world_flange = T_world_base @ T_base_flange
    reach = T_world_flange[:, :3, 3] - T_world_base[:3, 3]
    reach[:, 2] = 0
    T = T_world_flange.copy()
    T[:, 2, 3] -= low * (reach**2).sum(1)
    T[:, :3, :3] = rotations.exp(tilt * np.cross(reach, (0, 0, -1))) @ T[:, :3, :3]
    lower = replace(scene, transforms={**scene.transforms, ("base", "flange"): inverse(T_world_base) @ T})
    told = lower.dataset(1)
    return told.with_transforms({("base", "flange"): T_base_flange})


@pytest.mark.parametrize(("low", "tilt"), [(0.02, 0.0), (0.01, 0.01), (0.0, 0.01)])
def test_an_arm_that_bends_under_its_weight_is_named_with_how_much(low: float, tilt: float) -> None:
    [suspect, *_] = found(sagging(low, tilt))
    assert (suspect.cause.kind, suspect.cause.subject) == ("sag", "base-flange")
    assert suspect.value == pytest.approx([low, tilt], abs=1e-3)
    [red, *_] = findings(sagging(low, tilt))
    assert red.severity == "red"
    assert "where it reaches 1 m" in red.text


def test_a_ring_of_a_lidar_that_points_elsewhere_is_named() -> None:
    dataset = systems.camera_and_lidar(24, pixel_noise=NOISE, range_noise=0.005).dataset()
    points = np.concatenate(
        [label.points for c in dataset.collections for label in c.labels.values() if isinstance(label, PointLabels)]
    )
    rings, counts = np.unique(elevations(points.T).round(4), return_counts=True)
    ring = rings[counts.argmax()]

    def lower(_: int, __: str, label: Labels) -> Labels:
        if not isinstance(label, PointLabels):
            return label
        flat, angles = np.hypot(*label.points[:, :2].T), elevations(label.points.T)
        told = angles + 0.01 * (np.abs(angles - ring) < 1e-3)
        z = np.hypot(flat, label.points[:, 2]) * np.sin(told)
        xy = label.points[:, :2] * (np.cos(told) / np.cos(angles))[:, None]
        return replace(label, points=np.c_[xy, z])

    [suspect, *_] = found(relabelled(dataset, lower))
    assert (suspect.cause.kind, suspect.cause.subject[:-6]) == (
        "ring elevation",
        f"lidar's {ring_column(ring + 0.01)[:-6]}",
    )
    assert suspect.value[0] == pytest.approx(-0.01, abs=0.002)


def test_an_error_of_a_joint_that_comes_again_with_each_turn_is_named() -> None:
    scene = systems.jointed_arm(24, pixel_noise=NOISE)
    T, axis = scene.transforms["j1", "j2"], np.array([0.0, 0.6, 0.8])
    position = rotations.log(inverse(T[:1])[:, :3, :3] @ T[:, :3, :3]) @ axis
    error = 0.03 * np.cos(position - position.mean())
    off = T.copy()
    off[:, :3, :3] = T[:, :3, :3] @ rotations.exp((error - error.mean())[:, None] * axis)  # an offset is another cause
    seen = replace(scene, transforms={**scene.transforms, ("j1", "j2"): off}).dataset(1)
    [suspect, *_] = found(seen.with_transforms({("j1", "j2"): T}))
    assert (suspect.cause.kind, suspect.cause.subject) == ("eccentricity", "j1-j2")
    assert np.abs(suspect.value[:2]) == pytest.approx([0, 0.03], abs=0.005)


def test_an_encoder_with_another_zero_since_some_collection_is_named() -> None:
    scene = systems.jointed_arm(24, pixel_noise=NOISE)
    T, axis = scene.transforms["j1", "j2"], np.array([0.0, 0.6, 0.8])
    off = T.copy()
    off[14:, :3, :3] = T[14:, :3, :3] @ rotations.exp(0.01 * axis)
    seen = replace(scene, transforms={**scene.transforms, ("j1", "j2"): off}).dataset(1)
    [finding, *_] = findings(seen.with_transforms({("j1", "j2"): T}), Limits(), Assumptions())
    assert finding.text.startswith("j1-j2's encoder offset has changed from collection 014 on: off by ")
    assert abs(finding.value or 0) == pytest.approx(0.01, abs=0.001)


def test_too_few_collections_are_reported_as_untested() -> None:
    few = systems.stereo(4, seed=1, pixel_noise=NOISE).dataset(1)
    [finding] = findings(few)
    assert (finding.kind, finding.severity) == ("untested", "note")
    assert "4 collections are too few" in finding.text


def test_what_moves_a_joint_by_more_than_its_limit_is_red() -> None:
    dataset = with_intrinsics(
        systems.jointed_arm(24, seed=1, pixel_noise=NOISE).dataset(1), "cam", lambda values: values.__imul__(1.003)
    )
    wide = {"translation_mm": 1e3, "rotation_deg": 10.0, "joint_mm": 1e3}
    [red, *_] = findings(dataset, Limits(**wide, joint_deg=1e-6))
    assert red.severity == "red"
    assert red.sensors == ("j3",)
    assert "it moves j3 by 0 mm" in red.text
    assert all(each.severity == "note" for each in findings(dataset, Limits(**wide, joint_deg=10.0)))


def test_a_lens_that_its_model_cannot_draw_is_named() -> None:
    dataset = stereo()
    name = list(dataset.sensors)[1]
    camera = dataset.sensors[name].camera
    assert camera is not None
    centre, focal = np.array([camera.cx, camera.cy]), np.array([camera.fx, camera.fy])

    def drawn(_: int, sensor: str, label: Labels) -> Labels:
        if sensor != name or not isinstance(label, CornerLabels):
            return label
        x, y = ((label.pixels - centre) / focal).T
        return replace(label, pixels=label.pixels + 0.05 * focal * np.stack([x * x + y * y, 0 * y], -1))

    explanation = explain(calibrate(relabelled(dataset, drawn), Options(intrinsics=(name,))).solution.model)
    assert explanation is not None
    suspect = explanation.suspects[0]
    assert (suspect.cause.kind, suspect.cause.subject) == ("lens model", name)


@pytest.mark.parametrize("first", [1, 2, 22, 23])
def test_a_move_at_an_end_is_found_though_few_views_tell(first: int) -> None:
    """By less than what makes a view wrong by itself: 1 px."""
    suspect, *_ = found(knocked(first, (0.001, 0, 0, 0, 0, 0)))
    assert suspect.cause.kind == PLACE_KIND
    assert suspect.since in range(first - 1, first + 2)


@pytest.mark.parametrize("shaken", [0.0, 0.0004])
def test_a_move_that_few_views_tell_exceeds_how_the_others_scatter(shaken: float) -> None:
    """A camera that nods in every view has not moved where the last two nod by more."""
    nods = shaken * np.sin(np.arange(24.0))
    dataset = eye_to_hand()
    (sensor,) = dataset.sensors.values()
    camera = sensor.camera
    assert camera is not None
    focal = camera.fy

    def nodding(i: int, _: str, label: Labels) -> Labels:
        by = 0.0008 if i >= 22 else nods[i]
        return (
            replace(label, pixels=label.pixels + np.array([0, by * focal]))
            if isinstance(label, CornerLabels)
            else label
        )

    suspects = found(relabelled(dataset, nodding))
    assert any(each.cause.kind == PLACE_KIND and each.since == 22 for each in suspects) == (shaken == 0)


def test_freedom_is_that_of_the_few_errors_that_contribute() -> None:
    few, many = (
        Disagreement(1.0, 1.0, 0.0, {}, np.eye(6), np.eye(6), np.eye(6), 100 * common, 100 * each).freedom(slice(0, 6))
        for common, each in (
            (np.ones((20, 6, 1)), np.zeros((20, 6, 0))),
            (np.zeros((20, 6, 1)), np.broadcast_to(np.eye(6), (20, 6, 6))),
        )
    )
    assert few == pytest.approx(1, abs=0.01)
    assert many == pytest.approx(120, rel=0.01)


def test_what_is_known_by_few_views_is_said_after_what_is_certain() -> None:
    """The last two views say that the camera has moved by 12 ± 2 mm; all of them that it is 10 mm off by its lens."""

    def longer(values: Array) -> None:
        values[:2] *= 1.007

    dataset = knocked(22, (0.0, 0.0, 0.01, 0.0, 0.003, 0.0))
    limits = Limits(translation_mm=1, rotation_deg=1)
    said = findings(with_intrinsics(dataset, "cam", longer), limits, Assumptions())
    first, second = [each for each in said if each.severity == "red"]
    assert first.text.startswith("cam's focal length does not fit")
    assert second.text.startswith("cam has moved from collection 022 on")
    assert (first.moves_mm or 0) < (second.moves_mm or 0)


def test_of_few_views_the_guard_band_over_the_limit_is_undecided() -> None:
    """The last two views say that the camera has moved by 11 mm, and know it to 4 mm."""
    dataset = knocked(22, (0.0, 0.0, 0.01, 0.0, 0.003, 0.0))
    [red, beyond, within] = [
        findings(dataset, Limits(translation_mm=limit, rotation_deg=5), Assumptions())[0] for limit in (5, 13, 50)
    ]
    assert [each.severity for each in (red, beyond, within)] == ["red", "undecided", "note"]
    assert "as few views tell how far; that it has moved is certain" in beyond.text
    assert "(limit 13 mm, 5 deg)" in beyond.text


def test_what_few_views_tell_is_as_unsure_as_it_moves_the_sensor() -> None:
    """Two of 24 views know to 1 mm and 0.3 deg how far the board has moved; the camera is 0.2 mm off by that."""
    scene = systems.eye_to_hand(24, pixel_noise=NOISE)
    edge = ("flange", "board_link")
    before = scene.transforms[edge]
    after = retract(before, np.array([0.002, 0.002, 0.0, 0.005, 0.0, 0.0]))
    places = np.stack([before if i < 22 else after for i in range(24)])
    dataset = replace(scene, transforms={**scene.transforms, edge: places}).dataset()
    [note] = findings(dataset, Limits(translation_mm=1, rotation_deg=0.1), Assumptions())
    assert note.severity == "note"
    assert note.text.startswith("board has moved from collection 022 on")


def test_what_would_have_moved_twice_rather_contradicts_itself() -> None:
    calibration = calibrate(knocked(16, (0.001, 0, 0, 0, 0, 0)), Options(assume=ALL_EXACT))
    explanation = calibration.solution.explanation
    assert explanation is not None
    move, disagreement = explanation.suspects[0], explanation.disagreement
    contradicting = replace(disagreement, found=1e4 * disagreement.assumed)
    for suspects, first in (((move,), "suspect"), ((move, replace(move, since=8)), "contradiction")):
        calibration.solution.__dict__["explanation"] = Explanation(suspects, contradicting)
        assert what_does_not_fit(calibration, Limits())[0].kind == first


def test_views_that_contradict_each_other_are_red_where_the_result_is_rather_off_than_not() -> None:
    scene = systems.eye_to_hand(24, pixel_noise=NOISE)
    shaken = retract(scene.transforms["world", "cam"], np.random.default_rng(1).normal(0, 0.01, (24, 6)))
    dataset = replace(scene, transforms={**scene.transforms, ("world", "cam"): shaken}).dataset()
    calibration = calibrate(dataset)
    sigma = calibration.sigma_mm(("world", "cam"))
    varying = calibration.solution.varying
    assert varying is not None
    off = 1e3 * median_of_norm(varying.change[:3], varying.covariance[:3, :3])
    for cause, middle in ((varying, off), (None, sigma / 1.13)):
        calibration.solution.__dict__["varying"] = cause
        for limit, severity in ((1.07 * middle, "note"), (0.93 * middle, "red")):
            said = what_does_not_fit(calibration, Limits(translation_mm=limit))
            assert [each.severity for each in said if each.kind == "contradiction"] == [severity]


def test_the_curve_of_a_lens_without_distortion_is_its_projection() -> None:
    double_sphere = replace(scenes.PINHOLE, fx=500.0, fy=495.0, distortion=DoubleSphere(-0.2, 0.59))
    cameras = [scenes.camera("left", model=double_sphere), scenes.camera("right", model=scenes.WIDE)]
    model = calibrate(systems.stereo(12, pixel_noise=NOISE, sensors=cameras).dataset()).solution.model
    kinds = {subject: {cause.kind for cause in model.causes if cause.subject == subject} for subject in SUBJECTS}
    assert "projection" in kinds["left"] - kinds["right"]
    assert "radial distortion" in kinds["right"] - kinds["left"]
    assert kinds["left and right"] == {"focal length", "pixel convention"}  # no error of xi and of k1 is common
