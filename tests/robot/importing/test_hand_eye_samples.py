"""Pairs of poses, without images, become a verdict."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from calibration.__main__ import main
from calibration.base import InputError, UndeterminedError
from calibration.base.arrays import Array
from calibration.engine.comparison import COMPARISON_METHODS
from calibration.engine.dataset.model import Dataset, PoseLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.diagnosis.what_does_not_fit import what_does_not_fit
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.fixed_inputs import SCALE_KIND
from calibration.engine.estimation.options import ALL_EXACT, Options, PoseNoise
from calibration.engine.estimation.scale_and_lags import better_scale, divided
from calibration.engine.evaluation.specification import parse_evaluation
from calibration.engine.geometry.transforms import distance, local
from calibration.robot.importing.importing import import_data
from tests.engine.evaluation.scene import applicable
from tests.robot.importing.conftest import change
from tests.robot.importing.hand_eye import DEG, MM, WRITERS, X, Y, moveit, simulated, write_import

FRAME = "camera_optical_frame"
ROUGH = Options(description="rough")
ALL = {"shah", "li", "tsai", "park", "horaud", "andreff", "daniilidis"}


def imported(folder: Path, in_hand: bool, file: str = "pairs.csv", seed: int = 1, noise: float = 1.0) -> Dataset:
    folder.mkdir(exist_ok=True)
    config = write_import(folder, simulated(in_hand, seed, noise=noise), file)
    import_data(config, folder / "out", jobs=1)
    return read_dataset(folder / "out")


@pytest.mark.parametrize("in_hand", [True, False])
@pytest.mark.parametrize("file", WRITERS)
def test_every_file_gives_the_true_transforms(tmp_path: Path, file: str, in_hand: bool) -> None:
    found = calibrate(imported(tmp_path / "it", in_hand, file, noise=1e-3), ROUGH).dataset
    ends = [("tool0", FRAME, X), ("base_link", "board_link", Y)]
    if not in_hand:
        ends = [("tool0", "board_link", X), ("base_link", FRAME, Y)]
    for parent, child, true in ends:
        m, rad = (float(v) for v in distance(true, found.transform(parent, child)[0]))
        assert m < 1e-5
        assert rad < 1e-5


def test_the_noise_is_found_and_the_error_bars_are_as_large_as_the_errors(tmp_path: Path) -> None:
    """Of 20 recordings: normalised squared errors of 6 degrees of freedom have a mean of 6, within 3.5 sigma."""
    squares, levels = [], []
    for seed in range(20):
        found = calibrate(imported(tmp_path / str(seed), True, seed=seed), ROUGH)
        edge = ("tool0", FRAME)
        error = local(found.transforms[edge], X)
        squares.append(float(error @ np.linalg.solve(found.label_covariances[edge], error)))
        levels.append((found.noise_levels.pose_translation, found.noise_levels.pose_rotation))
    assert np.mean(squares) == pytest.approx(6, abs=3.5 * np.sqrt(2 * 6 / 20))
    np.testing.assert_allclose(np.mean(levels, 0), [1e-3 * MM, np.radians(DEG)], rtol=0.15)


def test_a_noise_that_is_stated_is_taken(tmp_path: Path) -> None:
    dataset = imported(tmp_path / "it", True)
    one, two = (calibrate(dataset, Options(description="rough", pose_noise=PoseNoise(k * MM, k * DEG))) for k in (1, 2))
    assert one.noise_levels.pose_translation == 1e-3 * MM
    edge = ("tool0", FRAME)
    assert two.label_sigma_mm(edge) == pytest.approx(2 * one.label_sigma_mm(edge), rel=0.02)


def test_a_wrong_pair_is_left_out_and_named(tmp_path: Path) -> None:
    folder = tmp_path / "it"
    folder.mkdir()
    samples = simulated(True)
    samples.seen[[3, 8]] = samples.seen[[8, 3]]
    import_data(write_import(folder, samples, "pairs.csv"), folder / "out", jobs=1)
    found = calibrate(read_dataset(folder / "out"), ROUGH)
    assert [view.collection for view in found.dropped_views] == ["003", "008"]
    assert float(distance(X, found.transforms["tool0", FRAME])[0]) < 3e-3


@pytest.mark.parametrize("in_hand", [True, False])
def test_other_methods_are_in_the_table(tmp_path: Path, in_hand: bool) -> None:
    dataset = imported(tmp_path / "it", in_hand)
    assert {method.name for method in applicable(dataset)} == ALL
    table = parse_evaluation("measured-poses:camera")
    ours = table.run(calibrate(dataset, ROUGH).dataset).average("Translation (mm)")
    for name in ALL:
        assert table.run(COMPARISON_METHODS[name].calibrate(dataset)).average("Translation (mm)") == pytest.approx(
            ours, rel=0.3
        )


def test_from_the_samples_to_a_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The three commands of the documentation."""
    monkeypatch.chdir(tmp_path)
    write_import(tmp_path, simulated(False), "robot.samples")
    assert main(["import-data", "--config", "import.yml", "--output", "data/robot"]) == 0
    assert main(["init", "--dataset", "data/robot"]) == 0
    file = tmp_path / "calibration.yml"
    assert yaml.safe_load(file.read_text())["systems"]["robot"]["evaluate"] == "measured-poses:camera"
    file.write_text(file.read_text() + "    compare: [shah, tsai]\n")
    capsys.readouterr()
    assert main(["run", "--jobs", "1"]) == 0
    shown = capsys.readouterr().out
    assert [line.split()[0] for line in shown.splitlines() if "poses off by 1." in line] == ["0", "shah", "tsai"]
    assert "camera: from where patterns were measured to where they come out" in Path("output/report.html").read_text()
    assert main(["accept"]) == 0
    assert main(["label", "--dataset", "data/robot", "--output", "data/labelled"]) == 2
    assert "found no camera among the sensors (camera), expected one with images to label" in capsys.readouterr().err
    assert main(["run", "--jobs", "1"]) == 0


def test_exchanged_mountings_are_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_import(tmp_path, simulated(True), "pairs.csv")
    change(tmp_path, "sensors", "camera", "parent", to="base_link")
    change(tmp_path, "patterns", "board", "parent", to="tool0")
    assert main(["import-data", "--config", "import.yml", "--output", "data/robot"]) == 0
    capsys.readouterr()
    assert main(["init", "--dataset", "data/robot"]) == 2
    error = capsys.readouterr().err
    assert "'camera' and 'board' mounted the other way round: the same equations" in error
    assert error.count("\n") == 1


def test_invalid_input_is_reported(tmp_path: Path) -> None:
    folder = tmp_path / "it"
    folder.mkdir()
    samples = simulated(True)

    def refused(message: str) -> None:
        with pytest.raises(InputError, match=message) as caught:
            import_data(folder / "import.yml", folder / "out", jobs=1)
        assert "\n" not in str(caught.value)

    write_import(folder, samples, "robot.samples")
    text = (folder / "robot.samples").read_text()
    (folder / "robot.samples").write_text(text.replace("calibration_type: ''", "calibration_type: eye_on_base"))
    refused("found 'eye_on_base', expected 'eye_in_hand' as import.yml has it: the parent of the sensor is the tool")
    (folder / "robot.samples").write_text(text.replace("tracking:", "optical:", 1))
    refused("samples/0: missing key 'tracking'")

    write_import(folder, samples, "moveit.yaml")
    samples.seen[2, 0, 0] += 0.01
    moveit(samples, folder / "moveit.yaml")
    refused("2/object_wrt_sensor: found no rigid transform")

    write_import(folder, simulated(True), "pairs.csv")
    lines = (folder / "pairs.csv").read_text().splitlines()
    (folder / "pairs.csv").write_text("\n".join([lines[0].replace(",pattern_qw", ""), *lines[1:]]))
    refused(r"pairs.csv:2: missing column 'pattern_qw', expected pattern_x, .*, pattern_qw")
    (folder / "pairs.csv").write_text("\n".join([lines[0], lines[1].rpartition(",")[0] + ",nan"]))
    refused("pairs.csv:2: found 'nan' as pattern_qw, expected a finite number")

    write_import(folder, simulated(True), "pairs.csv")
    change(folder, "sensors", "other", to={"parent": "tool0"})
    refused("'camera': missing key 'images'")
    change(folder, "sensors", "other", to=None)
    change(folder, "patterns", "other", to={"parent": "base_link"})
    refused("has poses of one pattern before one sensor, found 1 sensors and 2 patterns")
    change(folder, "patterns", "other", to=None)
    change(folder, "sensors", "camera", "intrinsics", to="camera.yaml")
    (folder / "camera.yaml").write_text("{intrinsics: {fx: 500, fy: 500, cx: 320, cy: 240}}")
    refused("found poses, no images: leave out 'intrinsics' of 'camera'")


def test_without_a_table_the_error_names_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    imported(tmp_path, True)
    arguments = ["calibrate-matrix", "--dataset", str(tmp_path / "out"), "--output", str(tmp_path / "cells")]
    assert main([*arguments, "--description", "rough"]) == 2
    assert "choose another table (evaluate), such as measured-poses:camera\n" in capsys.readouterr().err
    assert main([*arguments, "--description", "rough", "--evaluate", "measured-poses:camera"]) == 0


def scaled(dataset: Dataset, factor: float) -> Dataset:
    """The dataset as a camera alone would have measured it."""
    return divided(dataset, 1 / factor)


@pytest.mark.parametrize("factor", [0.01, 0.4, 1.0, 37.0])
@pytest.mark.parametrize("in_hand", [True, False])
def test_a_scale_that_is_free_is_found(tmp_path: Path, in_hand: bool, factor: float) -> None:
    dataset = imported(tmp_path / "it", in_hand, noise=1e-3)
    found = calibrate(scaled(dataset, factor), Options(description="rough", scale="free"))
    parent, child = ("tool0", FRAME) if in_hand else ("tool0", "board_link")
    m, rad = (float(v) for v in distance(X, found.dataset.transform(parent, child)[0]))
    assert m < 1e-5
    assert rad < 1e-5


def test_error_bars_have_the_uncertainty_of_a_free_scale(tmp_path: Path) -> None:
    """They are those of the scale as one more parameter beside the others; and as large as the errors."""
    squares = []
    for seed in range(20):
        dataset = scaled(imported(tmp_path / str(seed), True, seed=seed), 3.0)
        found = calibrate(dataset, Options(description="rough", scale="free"))
        error = local(found.transforms["tool0", FRAME], X)
        squares.append(float(error @ np.linalg.solve(found.covariances["tool0", FRAME], error)))
    assert np.mean(squares) == pytest.approx(6, abs=3.5 * np.sqrt(2 * 6 / 20))
    exact = calibrate(dataset, Options(description="rough", scale="free", assume=ALL_EXACT))
    model, bars = exact.solution.model, exact.error_bars
    [scale] = [at.start for cause, at in zip(model.causes, model.places, strict=True) if cause.kind == SCALE_KIND]
    columns = [*range(model.shared), scale]
    joint = np.linalg.inv(model.total[np.ix_(columns, columns)])
    for block, at in exact.solution.setup.problem.shared_parameters.items():
        assert bars is not None
        np.testing.assert_allclose(bars.expected[block], joint[at, at], rtol=1e-6, atol=1e-15)


def said_of(dataset: Dataset) -> str:
    """The error of a calibration, or its first finding."""
    try:
        return what_does_not_fit(calibrate(dataset, ROUGH), Limits())[0].text
    except UndeterminedError as error:
        return str(error)


@pytest.mark.parametrize("factor", [0.05, 1.2, 20.0])
def test_an_unknown_scale_is_named(tmp_path: Path, factor: float) -> None:
    """By an error where nothing fits, else by the suspect that does not."""
    said = said_of(scaled(imported(tmp_path / "it", True), factor))
    assert "scale: free" in said
    assert "nothing suspicious" in said_of(imported(tmp_path / "metric", True))


@pytest.mark.parametrize(("factor", "noise_m", "named"), [(3.0, 0.5, True), (3.0, 0.01, False), (1.0, 0.5, False)])
def test_another_scale_is_tried_where_a_result_fits_badly(
    tmp_path: Path, factor: float, noise_m: float, named: bool
) -> None:
    dataset = imported(tmp_path / "it", True, noise=3.0)
    found = calibrate(dataset, ROUGH)
    optimum = replace(found, noise_levels=replace(found.noise_levels, pose_translation=noise_m))
    other = better_scale(scaled(dataset, factor), ROUGH, optimum)
    assert (other == pytest.approx(factor, rel=0.05)) if named else other is None


@pytest.mark.parametrize(("factor", "red"), [(1.002, False), (1.02, True)])
def test_poses_as_long_as_a_board_and_a_lens_err_are_no_suspects(tmp_path: Path, factor: float, red: bool) -> None:
    found = what_does_not_fit(calibrate(scaled(imported(tmp_path / "it", True), factor), ROUGH), Limits())
    assert any(each.severity == "red" and "scale of poses" in each.text for each in found) == red


def test_poses_of_a_whole_arm_leave_the_transform_as_uncertain_as_arms_err(tmp_path: Path) -> None:
    """An error that all poses share leaves no residual: 0.3 mm along each axis, whatever the number of collections."""
    found = calibrate(imported(tmp_path / "it", True, noise=1e-6), ROUGH)
    assert found.sigma_mm(("tool0", FRAME)) >= 0.3 * 3**0.5
    exact = calibrate(imported(tmp_path / "same", True, noise=1e-6), replace(ROUGH, assume=ALL_EXACT))
    assert exact.sigma_mm(("tool0", FRAME)) < 0.01


def test_poses_that_only_turn_do_not_determine_their_scale(tmp_path: Path) -> None:
    dataset = imported(tmp_path / "it", True)
    edge = ("base_link", "tool0")
    still = dataset.transforms[edge].copy()
    still[:, :3, 3] = 0.0
    with pytest.raises(InputError, match="do not determine"):
        calibrate(dataset.with_transforms({edge: still}), Options(description="rough", scale="free"))


def moved_along_sight(dataset: Dataset, shifts: Array) -> Dataset:
    """The dataset with measured patterns farther away by so much (N,), m."""
    collections = []
    for collection, shift in zip(dataset.collections, shifts, strict=True):
        ((key, label),) = collection.labels.items()
        T = label.T.copy()
        T[:3, 3] *= 1 + shift / np.linalg.norm(T[:3, 3])
        collections.append(replace(collection, labels={key: PoseLabels(T)}))
    return replace(dataset, collections=tuple(collections))


@pytest.mark.thorough
def test_distances_that_are_worse_than_the_rest_count_for_less(tmp_path: Path) -> None:
    """Against the same noise in all directions; and the error bars are those of the errors."""
    errors, isotropic, squares = [], [], []
    for seed in range(20):
        shifts = 0.01 * np.random.default_rng(seed).normal(size=20)
        dataset = moved_along_sight(imported(tmp_path / str(seed), True, seed=seed, noise=0.3), shifts)
        found, plain = (
            calibrate(dataset, replace(ROUGH, assume=ALL_EXACT, pose_noise=noise))
            for noise in (None, PoseNoise(6.0, 0.03))
        )
        error = local(found.transforms["tool0", FRAME], X)
        errors.append(np.linalg.norm(error[:3]))
        isotropic.append(np.linalg.norm(local(plain.transforms["tool0", FRAME], X)[:3]))
        squares.append(float(error @ np.linalg.solve(found.covariances["tool0", FRAME], error)) / 6)
    assert np.median(errors) < 0.5 * np.median(isotropic)
    assert 0.6 < np.mean(squares) < 1.6


def test_an_unknown_scale_is_named_though_some_views_are_wrong(tmp_path: Path) -> None:
    """What fits so badly that nothing contradicts anything is no calibration."""
    dataset = scaled(imported(tmp_path / "it", True), 3.4)
    shifts = np.where(np.arange(20) % 6 == 0, 1.5, 0.0)
    with pytest.raises(UndeterminedError, match="the scale of the measured poses is unknown"):
        calibrate(moved_along_sight(dataset, shifts), ROUGH)
