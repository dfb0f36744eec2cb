"""Details of a calibration in a cell's own results."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.base import ExitCode, InputError
from calibration.ci.report import Report
from calibration.engine.comparison import method_of
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.diagnosis.against_optimum import find_optimum
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.options import ALL_EXACT, Options
from calibration.engine.estimation.problem.intrinsics import FILE_NAME as INTRINSICS
from calibration.engine.estimation.problem.intrinsics import read_intrinsics
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.evaluation.specification import parse_evaluation
from calibration.engine.evaluation.truth import truth_of
from calibration.engine.geometry.rotations import from_rpy, to_rpy
from calibration.engine.geometry.transforms import retract, translation
from calibration.pipeline.matrix import running_cell
from calibration.pipeline.matrix.cell_details import described, finite_deviation
from calibration.pipeline.matrix.cell_result import Cell, CellResult, Comparison, Details, ParameterResult
from calibration.pipeline.matrix.loaded_system import LoadedSystem
from calibration.pipeline.matrix.matrix import Matrix, run_matrix
from calibration.pipeline.matrix.running_cell import run_cell, run_comparison
from calibration.pipeline.report import report
from calibration.pipeline.report_tables import parameters_table, transforms_table
from calibration.pipeline.results import PipelineResults
from calibration.pipeline.system import NoiseGrid
from tests.engine.estimation.systems import jointed_arm, stereo, two_bodies
from tests.engine.estimation.test_wrong_views import exchanged
from tests.engine.evaluation.scene import T_LINK_OPTICAL, applicable, arm, range_pair, rgb, with_corners
from tests.pipeline.conftest import DATASETS, T2RGB
from tests.pipeline.matrix.test_cell_verdict import CELL

NOISES = NoiseGrid()


def told(results: PipelineResults) -> Report:
    return report(results, Path("out"))


def test_joints_are_reported_with_their_sigmas() -> None:
    scene = jointed_arm(free={"j2": ("position_bias",), "j3": ("origin_yaw",)}, pixel_noise=0.2)
    calibration = calibrate(scene.dataset())
    found = described(CELL, calibration, scene.dataset(), Limits()).details.joints
    told = [(each.name, each.parameter, each.unit) for each in found]
    asked = [(joint.name, parameter) for joint in calibration.joints.values() for parameter in joint.parameters]
    assert [each[:2] for each in told] == asked
    assert {each[2] for each in told} <= {"m", "rad"}
    assert calibration.converged
    values = np.concatenate([joint.values for joint in calibration.joints.values()])
    assert [each.value for each in found] == values.tolist()
    assert all(0 < each.sigma < 1 for each in found)


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_a_deviation_that_is_no_number_is_bad_input(number: float) -> None:
    with pytest.raises(InputError, match="the distance from the truth: found a number that is not finite"):
        finite_deviation("the distance from the truth", 1.0, 1.0, None, number)


def test_a_cell_reports_the_largest_standard_deviations(tmp_path: Path) -> None:
    dataset = read_dataset(DATASETS / "spjbot")
    result = run_cell(Cell("spjbot", StartingNoise()), LoadedSystem("spjbot", dataset, None, None), tmp_path)
    stated = calibrate(dataset)

    assert result.sigma is not None
    edge = dataset.sensors["rgb_hand"].edge
    turning = [float(np.degrees(stated.joints[j].sigmas[0])) for j in ("j2_joint", "j4_joint")]
    assert result.sigma.translation_mm == pytest.approx(stated.sigma_mm(edge), abs=1e-6)
    assert result.sigma.rotation_deg == pytest.approx(np.degrees(stated.sigma_mrad(edge) / 1e3), abs=1e-8)
    assert result.sigma.joint_mm == pytest.approx(1e3 * stated.joints["j3_joint"].sigmas[0], abs=1e-6)
    assert result.sigma.joint_deg == pytest.approx(max(turning), abs=1e-8)


def test_other_methods_calibrate_no_joints() -> None:
    dataset = jointed_arm().dataset()
    assert applicable(dataset) == []
    with pytest.raises(InputError, match=r"^Shah calibrates no joints, and the dataset asks for j3$"):
        method_of("shah").calibrate(dataset)


def loaded(name: str, dataset: Dataset) -> LoadedSystem:
    """A system as if it had been read from a file that had no transforms, whose own are the truth."""
    empty: dict[str, Any] = {key: {"transforms": {}} for key in dataset.keys}
    document = {"_metadata": {}, "calibration_config": {"calibration_patterns": {"board": {}}}, "collections": empty}
    return LoadedSystem(name, replace(dataset, document=document), truth_of(dataset), None)


def lidars() -> LoadedSystem:
    """Two LiDARs and a camera that see a pattern; LiDAR "one" is anchored."""
    dataset, T_world_pattern = range_pair(n=4, kinds=("lidar3d", "lidar3d"))
    eye = rgb("eye")
    still = {
        ("world", eye.calibration_parent): np.eye(4),
        eye.edge: np.eye(4),
        ("eye_link", "eye_optical"): T_LINK_OPTICAL,
    }
    dataset = replace(dataset, sensors={"eye": eye, **dataset.sensors}).with_transforms(still)
    return loaded("pair", with_corners(dataset, T_world_pattern, np.random.default_rng(1), 0.0))


def compared(system: LoadedSystem, output: Path, *noise: float, method: str = "icp") -> CellResult:
    start = StartingNoise(*noise) if noise else None
    return run_comparison(Comparison(system.name, method, start), system, output)


def test_a_method_that_depends_on_the_start_starts_from_the_noise(tmp_path: Path) -> None:
    system = lidars()
    here, near, far = (compared(system, tmp_path, *noise) for noise in ((0.0, 0.0), (0.02, 0.02), (3.0, 0.0)))
    assert here.truth is not None
    assert near.truth is not None
    assert here.truth.translation_mm < near.truth.translation_mm + 1e-3
    assert near.truth.translation_mm < 20  # it has come nearer
    assert (near.start, near.translation_noise, near.rotation_noise, near.seed) == ("given", 0.02, 0.02, 1)
    assert near.detail == "built in"
    assert near.name == "pair, icp, 0.02 m, 0.02 rad, seed 1"
    assert near.dataset == "pair/icp/translation-0.02_rotation-0.02_seed-1/dataset.json"
    assert (tmp_path / near.dataset).is_file()
    assert not far.converged
    assert "starts from the dataset's transforms, which lie too far off" in far.reasons[0]


def test_a_pair_is_judged_without_the_other_sensors(tmp_path: Path) -> None:
    """From 0.02 m of noise the camera stays 20 mm off; the row has the error of the LiDARs only."""
    system = lidars()
    table = compared(replace(system, evaluation=parse_evaluation("lidar-to-lidar:one:two")), tmp_path, 0.02, 0.0)
    assert table.table is not None
    assert (tmp_path / table.table).is_file()
    none = compared(replace(system, evaluation=parse_evaluation("lidar-to-rgb:one:eye")), tmp_path, 0.02, 0.0)
    assert (none.converged, none.table, none.rms_px) == (True, None, None)
    assert none.truth == table.truth
    assert none.truth is not None
    assert none.truth.translation_mm < 15


def test_a_method_that_takes_no_start_has_one_row(tmp_path: Path) -> None:
    found = compared(loaded("robot", arm(n=6)), tmp_path, method="shah")
    assert found.converged
    assert (found.start, found.translation_noise, found.seed) == (None, None, None)
    assert found.name == "robot, shah"
    assert found.dataset == "robot/shah/dataset.json"
    assert found.detail is not None


def test_a_failed_method_has_no_statistics(tmp_path: Path) -> None:
    found = compared(replace(lidars(), dataset=arm(n=6)), tmp_path, 0.5, 0.0)
    assert (found.converged, found.detail, found.error) == (False, None, ExitCode.BAD_INPUT)
    assert "it needs two LiDARs" in found.reasons[0]


def test_intrinsics_are_reported_with_their_sigmas_and_written_for_the_next_run(tmp_path: Path) -> None:
    written = run_matrix(
        Matrix((replace(T2RGB, options=Options(intrinsics=("all",), hold=("intrinsics-left_camera-k3",))),), NOISES),
        tmp_path,
        1,
    )
    (cell,) = written.cells
    assert cell.verdict == "pass"
    assert cell.dataset is not None
    rows = cell.details.intrinsics
    assert [row.parameter for row in rows if row.name == "left_camera"] == [
        "fx",
        "fy",
        "cx",
        "cy",
        "k1",
        "k2",
        "p1",
        "p2",
    ]
    assert {row.unit for row in rows} == {"px", "1"}
    truth = read_dataset(T2RGB.dataset)
    for row in rows:  # the cameras that were simulated are those of the dataset
        camera = truth.sensors[row.name].camera
        assert camera is not None
        true = dict(zip(camera.parameters, camera.intrinsics.tolist(), strict=True))[row.parameter]
        assert abs(row.value - true) < 5 * row.sigma
    folder = (tmp_path / cell.dataset).parent
    known = read_intrinsics(folder / "intrinsics.json")
    found = read_dataset(folder).sensors["left_camera"].camera
    assert found is not None
    np.testing.assert_array_equal(known["left_camera"].values, found.intrinsics[:8])
    later = replace(
        T2RGB,
        dataset=folder,
        truth="none",
        options=Options(assume=ALL_EXACT, intrinsics_covariance=folder / "intrinsics.json"),
    )
    wider = run_matrix(
        Matrix((later, replace(later, name="plain", options=Options(assume=ALL_EXACT))), NOISES), tmp_path / "later", 1
    )
    sigmas = [[each.sigma_mm for each in c.details.transforms if each.sigma_mm] for c in wider.cells]
    assert min(sigmas[0]) > 2 * max(sigmas[1])
    assert wider.cells[0].rms_px == wider.cells[1].rms_px
    assert not list((tmp_path / "later").rglob("intrinsics.json"))


def test_intrinsics_that_are_not_there_are_a_cell_s_bad_input(tmp_path: Path) -> None:
    (cell,) = run_matrix(
        Matrix((replace(T2RGB, options=Options(intrinsics=("middle_camera",))),), NOISES), tmp_path, 1
    ).cells
    assert cell.error == ExitCode.BAD_INPUT
    assert (
        "intrinsics: 'middle_camera' is no sensor, expected all or cameras (left_camera, right_camera)"
        in cell.reasons[0]
    )


def test_a_wrong_covariance_stops_before_anything_is_calibrated(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.json: a JSON document was expected"):
        run_matrix(
            Matrix((replace(T2RGB, options=Options(intrinsics_covariance=tmp_path / "none.json")),), NOISES),
            tmp_path,
            1,
        )


def test_transforms_are_shown_with_their_error_bars() -> None:
    calibration = calibrate(stereo(20, seed=1, pixel_noise=0.2).dataset(1))
    wrong = stereo(20, seed=1, pixel_noise=0.2).dataset(1)
    edge = next(edge for edge in calibration.covariances if edge[1] in ("left", "right"))
    shifted = wrong.with_transforms({edge: wrong.transforms[edge] @ translation((0.01, 0.0, 0.0))})
    found = {(t.parent, t.child): t for t in described(CELL, calibration, shifted, Limits()).details.transforms}
    free, [held] = found[edge], [t for each, t in found.items() if each != edge]
    T = calibration.transforms[edge]
    np.testing.assert_allclose(from_rpy(free.rpy), T[:3, :3], atol=1e-12)
    assert free.moved_mm == pytest.approx(10, abs=0.5)
    assert math.hypot(*free.sigma_trans) == pytest.approx(free.sigma_mm / 1e3)
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(6), calibration.covariances[edge], 4000)
    moved = retract(T, draws)
    np.testing.assert_allclose(moved[:, :3, 3].std(0), free.sigma_trans, rtol=0.06)
    np.testing.assert_allclose(to_rpy(moved[:, :3, :3]).std(0), free.sigma_rpy, rtol=0.06)
    rows = transforms_table(PipelineResults((replace(CELL, details=Details(transforms=(free, held))),))).rows
    assert [row[-1] for row in rows] == [f"{free.moved_mm:.3g} mm, {free.moved_deg:.2g} deg", "held"]
    assert f" ± {free.sigma_mm:.2g}" in rows[0][1]
    assert "+-" not in rows[1][1]
    assert "-0.00," not in "".join(rows[1])


def test_the_summary_shows_joints_and_intrinsics_of_the_first_cell_that_passed() -> None:
    rows = (ParameterResult("left", "fx", 554.256258, "px", 0.1234), ParameterResult("left", "k1", -0.1, "1", None))
    joint = (ParameterResult("elbow", "position_bias", 0.0123456789, "rad", 1e-4),)
    cells = (
        replace(CELL, reasons=("no",), details=Details(joints=joint, intrinsics=())),
        replace(CELL, details=Details(joints=joint, intrinsics=rows)),
        replace(CELL, details=Details(joints=(), intrinsics=())),
    )
    assert parameters_table(PipelineResults(cells)).rows == (
        ("robot", "elbow", "position_bias", "0.0123457", "0.0001", "rad"),
        ("robot", "left", "fx", "554.256", "0.12", "px"),
        ("robot", "left", "k1", "-0.1", "-", "1"),
    )
    assert "| robot | left | fx | 554.256 | 0.12 | px |" in told(PipelineResults(cells)).markdown()
    assert "Joints and intrinsics" not in told(PipelineResults((CELL,))).markdown()
    assert "Joints and intrinsics" not in told(PipelineResults(cells[2:])).markdown()


def test_what_most_labels_do_not_fit_is_no_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = calibrate(read_dataset(T2RGB.dataset))
    count = sum(int(np.isfinite(view.magnitudes).sum()) for view in found.residuals)
    few, more = (replace(found, rejected=found.rejected[:1] * n) for n in (count // 21, count // 2 + 1))
    for calibration, verdict in ((few, "pass"), (more, "fail")):
        monkeypatch.setattr(running_cell, "solve", lambda *_, calibration=calibration: calibration)
        results = run_matrix(Matrix((T2RGB,), NOISES), tmp_path / verdict, 1)
        assert results.cells[0].verdict == verdict
    assert results.cells[0].reasons[0].startswith(f"{count // 2 + 1} of {count} labels do not fit the result")
    assert "look at the intrinsics" in results.cells[0].reasons[0]


def test_views_that_contradict_the_others_are_named_and_in_no_table(tmp_path: Path) -> None:
    dataset = exchanged(read_dataset(DATASETS / "riwbot"), "rgb_world", (3, 8, 11))
    system = LoadedSystem(
        "riwbot", dataset, truth_of(dataset), parse_evaluation("inter-collection-rgb-to-rgb:rgb_world:rgb_world")
    )
    result = run_cell(Cell("riwbot", StartingNoise()), system, tmp_path)
    [warning] = result.warnings
    assert warning.startswith("rgb_world: views of collections 003, 008, 011 contradict the others, by up to")
    assert result.rms_px is not None
    assert result.rms_px < 0.2
    assert result.details is not None
    assert [view.collection for view in result.details.dropped_views] == ["003", "008", "011"]
    assert result.dataset is not None
    written = read_dataset(tmp_path / result.dataset)
    assert ("pattern_1", "rgb_world") in written.collections[3].labels


def test_its_files_may_be_in_another_folder(tmp_path: Path) -> None:
    """As those of our engine beside a team's software."""
    system = loaded("pair", stereo(8, pixel_noise=0.3).dataset())
    found = run_cell(Cell("pair", StartingNoise()), system, tmp_path, "elsewhere")
    assert (found.folder, found.dataset) == ("elsewhere", "elsewhere/dataset.json")
    assert [path.name for path in tmp_path.iterdir()] == ["elsewhere"]


def test_a_start_that_is_not_possible_leaves_nothing(tmp_path: Path) -> None:
    system = replace(loaded("pair", two_bodies(8, pixel_noise=0.3).dataset()), options=Options(start="given"))
    cells = (Cell("pair", StartingNoise(2.0, 2.0, seed), "given") for seed in range(40))
    results = (run_cell(cell, system, tmp_path / str(cell.noise.seed)) for cell in cells)
    found = next(each for each in results if "behind a camera" in str(each.reasons))
    assert (found.converged, found.error) == (False, None)
    assert (found.rms_px, found.truth, found.table, found.dataset, found.folder) == (None,) * 5
    assert not (tmp_path / str(found.seed)).exists()


def test_what_cannot_be_evaluated_is_neither_compared_nor_complete(tmp_path: Path) -> None:
    system = loaded("pair", stereo(8, pixel_noise=0.3).dataset())
    system = replace(system, evaluation=parse_evaluation("lidar-to-lidar:one:two"))
    found = run_cell(Cell("pair", StartingNoise()), system, tmp_path)
    assert (found.converged, found.error, found.folder) == (False, ExitCode.BAD_INPUT, None)
    assert "no sensor 'one'" in found.reasons[0]
    assert found.details is not None
    assert found.details.snapshot is None


def test_intrinsics_are_written_only_if_it_converged(tmp_path: Path) -> None:
    options = Options(start="given", intrinsics=("all",))
    system = LoadedSystem("t2rgb", read_dataset(DATASETS / "t2rgb"), None, None, options)
    written: dict[bool, bool] = {}
    for noise in (StartingNoise(), *(StartingNoise(3.0, 2.5, seed) for seed in range(1, 6))):
        found = run_cell(Cell("t2rgb", noise, "given"), system, tmp_path)
        if found.folder is not None:
            written.setdefault(found.converged, (tmp_path / found.folder / INTRINSICS).exists())
    assert written == {True: True, False: False}


def test_findings_on_another_optimum_are_its_own() -> None:
    system = loaded("pair", stereo(10, pixel_noise=0.1).dataset())
    other = find_optimum(exchanged(system.dataset, "left", (3, 8)), system.options)
    kinds = [{each.kind for each in system.findings_of(optimum)} for optimum in (system.optimum, other)]
    assert kinds[1] - kinds[0]
