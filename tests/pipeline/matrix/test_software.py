"""The team's software in a cell: its inputs, and its results by its files."""

import json
import re
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from calibration.base import ExitCode, InputError
from calibration.ci.execution.job import OUTPUT, Artifact
from calibration.ci.execution.outcome import ArtifactFile, JobOutcome
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.writing import write_dataset
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.least_squares.minimisation import Termination, minimise
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.start.build import build
from calibration.engine.estimation.start.guesses import StartingNoise, guess_with_patterns, with_starting_noise
from calibration.engine.evaluation.specification import parse_evaluation
from calibration.engine.geometry.transforms import translation
from calibration.pipeline.containers import (
    DATASET_FOLDER,
    START_FOLDER,
    Software,
    adjusted_software,
    software_from,
)
from calibration.pipeline.matrix.cell_result import Cell, CellResult
from calibration.pipeline.matrix.loaded_system import LoadedSystem, load
from calibration.pipeline.matrix.software_cell import cell_job, software_result
from calibration.pipeline.system import System

DATASETS = Path(__file__).parents[3] / "datasets"
CELL = Cell("t2rgb", StartingNoise(0.5, 0.1, 7))
TABLE = "Collection #,RMS (pix),X err (pix)\n000,0.25,0.1\nAverages,0.25,0.1\n"


def software(**entry: object) -> Software:
    return software_from({"image": "robot:1", "command": "calibrate {start} {output}", **entry}, Path(), "software")


def test_the_command_is_filled_argument_by_argument() -> None:
    asked = software(command=["run", "{start}", "-o", "{output}/x y", "{translation_noise}:{rotation_noise}", "{seed}"])
    job = cell_job(CELL, asked, DATASETS / "t2rgb", DATASETS)
    [container] = job.containers
    assert job.name == CELL.folder
    assert container.command == ("run", START_FOLDER, "-o", f"{OUTPUT}/x y", "0.5:0.1", "7")
    assert [(m.source, m.target, m.writable) for m in container.mounts] == [
        (DATASETS / "t2rgb", DATASET_FOLDER, False),
        (DATASETS, START_FOLDER, False),
    ]
    assert container.artifacts == (Artifact(f"{OUTPUT}/*"),)


def test_no_digit_of_a_noise_is_lost() -> None:
    near = Cell("t2rgb", StartingNoise(0.12345671, 1e-5, 7)), Cell("t2rgb", StartingNoise(0.12345672, 1e-5, 7))
    assert len({cell.folder for cell in near}) == len({str(cell) for cell in near}) == 2
    [container] = cell_job(
        near[0], software(command="run {translation_noise} {rotation_noise}"), DATASETS, DATASETS
    ).containers
    assert container.command == ("run", "0.12345671", "1e-05")


def test_a_ros_master_only_where_it_is_asked_for() -> None:
    assert len(cell_job(CELL, software(), DATASETS, DATASETS).containers) == 1
    names = [c.name for c in cell_job(CELL, software(ros=1), DATASETS, DATASETS).containers]
    assert names == ["master", "calibration"]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"command": "run {sead}"}, r"placeholder '\{sead\}': did you mean 'seed'"),
        ({"artifacts": ["{out}/*"]}, r"placeholder '\{out\}'"),
        ({"artifacts": ["relative/*"]}, "relative"),
        ({"command": 'run "'}, "cannot be split"),
        ({"command": []}, "command"),
        ({"timeout": "soon"}, "timeout.*found 'soon'"),
    ],
)
def test_errors_are_raised_before_anything_runs(entry: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        cell_job(CELL, software(**entry), DATASETS, DATASETS)


def test_options_go_before_the_configuration() -> None:
    configured = software(timeout="5m", memory="1g", artifacts=["{output}/a.csv"], ros="1")
    asked = adjusted_software(configured, {"image": "robot:2", "timeout": "1m"}, Path())
    assert asked.container.image == "robot:2"
    assert asked.container.limits.seconds == 60
    assert asked.container.limits.memory == 1024**3
    assert asked.container.command == configured.container.command
    assert asked.container.artifacts == configured.container.artifacts
    assert asked.ros == "1"
    with pytest.raises(InputError, match="image and command belong together"):
        adjusted_software(None, {"image": "robot:1"}, Path())


@cache
def loaded(evaluate: str | None = None) -> LoadedSystem:
    """The system, with our optimum, as the cells of a run share it."""
    return load(System("t2rgb", DATASETS / "t2rgb", evaluate=evaluate))


@pytest.fixture
def result_of(tmp_path: Path) -> Callable[..., CellResult]:
    def judged(files: dict[str, str | Path], asked: Software | None = None, evaluate: str | None = None) -> CellResult:
        system = loaded(evaluate)
        folder = tmp_path / CELL.folder
        for name, content in files.items():
            path = folder / "artifacts" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, Path):
                shutil.copy(content, path)
            else:
                path.write_text(content)
        artifacts = tuple(ArtifactFile(name, "calibration", 1, "") for name in files)
        outcome = JobOutcome(CELL.folder, folder, artifacts=artifacts, seconds=1.0)
        return software_result(CELL, system, asked or software(calibrated="none"), outcome, tmp_path)

    return judged


def test_the_table_gives_the_rms(result_of: Callable[..., CellResult]) -> None:
    result = result_of({"sub/table.csv": TABLE, "log.txt": "fine"})
    assert (result.verdict, result.rms_px, result.method) == ("pass", 0.25, "software")
    assert result.table == f"{CELL.folder}/artifacts/sub/table.csv"
    assert (result.translation_noise, result.rotation_noise, result.seed) == (0.5, 0.1, 7)


def test_a_table_without_averages_is_a_table(result_of: Callable[..., CellResult]) -> None:
    result = result_of({"table.csv": "Name,Error\na,1\n"})
    assert (result.verdict, result.rms_px) == ("pass", None)


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({}, "left no file; expected exactly one file '*.csv'"),
        ({"a.txt": ""}, "left a.txt; expected exactly one file"),
        ({"a.csv": TABLE, "b.csv": TABLE}, "left a.csv, b.csv; expected exactly one file"),
        ({"a.csv": ""}, "a.csv"),
        ({"a.csv": TABLE.replace("Averages,0.25", "Averages,nan")}, "found 'nan', a finite number was expected"),
        ({"a.csv": TABLE.replace("Averages,0.25", "Averages,")}, "found '', a finite number was expected"),
        ({"a.csv": TABLE + "Averages,0.25,0.1\n"}, "more than one row is labelled 'Averages'"),
    ],
)
def test_an_empty_table_is_no_pass(result_of: Callable[..., CellResult], files: dict[str, str], message: str) -> None:
    result = result_of(files)
    assert result.verdict == "fail"
    assert result.error is None
    assert message in result.reasons[0]


def test_one_of_several_tables_is_named(result_of: Callable[..., CellResult]) -> None:
    result = result_of(
        {"a.csv": TABLE, "b.csv": TABLE.replace("0.25", "0.5")}, software(table="b.csv", calibrated="none")
    )
    assert result.rms_px == 0.5


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Our optimum, as software would leave it."""
    return write_dataset(loaded().optimum.calibration.dataset, tmp_path_factory.mktemp("ours"), images=False)


def test_the_optimum_passes_with_its_distance(result_of: Callable[..., CellResult], ours: Path) -> None:
    result = result_of({"calibrated.json": ours, "t.csv": TABLE, "log.txt": ""}, software())
    assert (result.verdict, result.reasons) == ("pass", ())
    assert result.truth is not None
    assert result.truth.translation_mm < 0.1
    assert result.rms_px == 0.25  # its own table is the one that is judged
    kinds = {found.kind: found.severity for found in result.findings}
    assert kinds["against-optimum"] == "note"
    assert kinds["table"] == "note"  # nothing says how it is made


def test_software_is_read_without_the_data_beside_its_dataset(tmp_path: Path) -> None:
    system = LoadedSystem("rlbot", read_dataset(DATASETS / "rlbot").with_collections(range(5)), None, None)
    path = write_dataset(with_starting_noise(system.dataset, CELL.noise), tmp_path / "noisy", images=False)
    folder = tmp_path / "cell"
    (folder / "artifacts").mkdir(parents=True)
    shutil.copy(path, folder / "artifacts")
    outcome = JobOutcome("cell", folder, artifacts=(ArtifactFile("dataset.json", "c", 1, ""),), seconds=1.0)
    result = software_result(Cell("rlbot", CELL.noise), system, software(), outcome, tmp_path)
    [reason] = result.reasons
    assert "'lidar_right' by " in reason
    assert "It has returned its start unchanged" in reason


def test_what_is_wrong_with_the_data_is_red_whoever_calibrates_them(tmp_path: Path) -> None:
    """A sensor 0.4 m from where the robot's description has it."""
    given = loaded().dataset
    edge = given.sensors["right_camera"].edge
    elsewhere = given.transforms[edge] @ translation(np.array([0.4, 0, 0]))
    system = LoadedSystem("t2rgb", given.with_transforms({edge: elsewhere}), None, None)
    path = write_dataset(system.optimum.calibration.dataset, tmp_path / "cell" / "artifacts" / "d.json", images=False)
    outcome = JobOutcome("cell", tmp_path / "cell", artifacts=(ArtifactFile(path.name, "c", 1, ""),), seconds=1.0)
    result = software_result(CELL, system, software(), outcome, tmp_path)
    assert {found.severity for found in result.findings if found.kind == "against-optimum"} == {"note"}
    assert result.verdict == "fail"


def off_by(millimetres: float) -> Dataset:
    found = loaded().optimum.calibration.dataset
    edge = found.sensors["right_camera"].edge
    return found.with_transforms({edge: found.transforms[edge] @ translation(np.array([millimetres / 1e3, 0, 0]))})


def one_step() -> Dataset:
    """Result of our engine, stopped after one step."""
    dataset = with_starting_noise(loaded().dataset, StartingNoise(0.05, 0.05, 1))
    setup = build(dataset)
    start = guess_with_patterns(setup)
    weighting = Weighting({"pixel": 1.0}, None)
    values = minimise(setup.problem, start, weighting, Termination(iterations=1)).values
    edges = {sensor.edge: values[setup.block(sensor.edge)] for sensor in dataset.sensors.values()}
    return dataset.with_transforms(edges)


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (lambda: off_by(2), "'left_camera' to 'right_camera' by 2 mm and 0 deg (limit 1 mm"),
        (lambda: with_starting_noise(loaded().dataset, CELL.noise), "It has returned its start unchanged"),
        (one_step, "stopped early"),
    ],
)
def test_far_from_the_optimum_is_red_with_the_distance(
    result_of: Callable[..., CellResult], tmp_path: Path, made: Callable[[], Dataset], says: str
) -> None:
    result = result_of(
        {"d.json": write_dataset(made(), tmp_path / "made.json", images=False), "t.csv": TABLE}, software()
    )
    assert (result.verdict, result.converged, result.error) == ("fail", True, None)
    [reason] = result.reasons
    assert reason.startswith(
        "the software's calibration is far from our optimum on the same labels: 'left_camera' to 'right_camera' by "
    )
    assert says in reason


def test_no_dataset_is_no_pass_unless_configured(result_of: Callable[..., CellResult]) -> None:
    result = result_of({"t.csv": TABLE}, software())
    assert (result.verdict, result.rms_px) == ("fail", 0.25)
    [reason] = result.reasons
    assert reason.startswith("calibrated: the software left t.csv; expected exactly one file '*.json': its calibrated")
    assert "calibrated: none" in reason
    believed = result_of({"t.csv": TABLE, "other.json": "{"}, software(calibrated="none"))
    assert (believed.verdict, believed.reasons) == ("pass", ())
    [note] = believed.findings
    assert (note.severity, "not verified" in note.text) == ("note", True)


RGB_TO_RGB = "rgb-to-rgb:right_camera:left_camera"


def test_without_a_table_of_its_own_we_evaluate_its_dataset(result_of: Callable[..., CellResult], ours: Path) -> None:
    result = result_of({"dataset.json": ours}, software(calibrated="dataset.json"), RGB_TO_RGB)
    assert result.verdict == "pass"
    assert result.table == f"{CELL.folder}/rgb_to_rgb_results.csv"
    assert result.rms_px is not None
    assert 0.05 < result.rms_px < 0.2


def test_a_table_follows_from_its_dataset_or_is_red(
    result_of: Callable[..., CellResult], ours: Path, tmp_path: Path
) -> None:
    table = parse_evaluation(RGB_TO_RGB).run(read_dataset(ours)).to_csv()
    assert result_of({"d.json": ours, "t.csv": table}, software(), RGB_TO_RGB).verdict == "pass"

    zeros = re.sub(r"\b[0-9]+\.[0-9]+", "0.0000", table)
    result = result_of({"d.json": ours, "t.csv": zeros}, software(), RGB_TO_RGB)
    [reason] = result.reasons
    assert "the table says RMS (pix) 0.0000 for 000, its dataset gives 0.0" in reason

    wrong = write_dataset(off_by(20), tmp_path / "wrong.json", images=False)
    result = result_of({"d.json": wrong, "t.csv": table}, software(), RGB_TO_RGB)
    distance, follows = result.reasons
    assert "by 20 mm" in distance
    assert re.search(r"the table says RMS \(pix\) 0\.\d+ for 000, its dataset gives 3\.", follows)


def test_a_table_of_zeros_is_red_if_its_kind_is_unknown(result_of: Callable[..., CellResult], ours: Path) -> None:
    result = result_of({"d.json": ours, "t.csv": TABLE.replace("0.25", "0")}, software())
    assert result.reasons == ("the table says RMS 0 px, but the noise of the labels leaves 0.07496 px at the optimum",)


def test_the_limits_of_the_system_are_those_of_the_distance() -> None:
    limits = Limits(translation_mm=3, rotation_deg=0.1)
    system = load(System("t2rgb", DATASETS / "t2rgb", limits=limits))
    assert system.limits == limits


def test_labels_of_something_else_are_red(result_of: Callable[..., CellResult], ours: Path, tmp_path: Path) -> None:
    fewer = write_dataset(read_dataset(ours).with_collections(range(20)), tmp_path / "fewer.json", images=False)
    [reason] = result_of({"d.json": fewer, "t.csv": TABLE}, software()).reasons
    assert "it has 20 collections, expected 26" in reason
    document = json.loads(ours.read_text())
    label = document["collections"]["003"]["labels"][next(iter(document["patterns"]))]["left_camera"]["idxs"][0]
    label["x"] += 3
    [reason] = result_of({"d.json": json.dumps(document), "t.csv": TABLE}, software()).reasons
    assert "collection 003: the labels of 'left_camera' differ by up to 3 px" in reason


@pytest.mark.parametrize("content", ["{", "[]", '{"collections": {}}', "NaN"])
def test_a_calibrated_dataset_that_is_none_has_failed(
    result_of: Callable[..., CellResult], content: str, ours: Path
) -> None:
    if content == "NaN":
        content = re.sub(r'("trans": \[\s*)[-0-9.e]+', r"\1NaN", ours.read_text(), count=1)
        assert "NaN" in content
    result = result_of({"d.json": content, "t.csv": TABLE}, software(calibrated="d.json"))
    assert (result.verdict, result.error) == ("fail", None)
    [reason] = result.reasons
    assert "d.json" in reason


def test_data_that_cannot_be_calibrated_verify_nothing(tmp_path: Path) -> None:
    two = load(System("t2rgb", DATASETS / "t2rgb")).dataset.with_collections([0])
    system = LoadedSystem("t2rgb", two, None, None)
    folder = tmp_path / "cell"
    path = write_dataset(two, folder / "artifacts" / "d.json", images=False)
    outcome = JobOutcome("cell", folder, artifacts=(ArtifactFile(path.name, "c", 1, ""),), seconds=1.0)
    [reason] = software_result(CELL, system, software(), outcome, tmp_path).reasons
    assert reason.startswith("not verified: our engine finds no optimum on the same labels: ")


@pytest.mark.parametrize(
    ("code", "error"),
    [
        (ExitCode.FAIL, None),
        (ExitCode.BAD_INPUT, ExitCode.BAD_INPUT),
        (ExitCode.INFRASTRUCTURE, ExitCode.INFRASTRUCTURE),
    ],
)
def test_a_failed_job_has_a_reason(tmp_path: Path, code: ExitCode, error: ExitCode | None) -> None:
    system = load(System("t2rgb", DATASETS / "t2rgb"))
    outcome = JobOutcome(CELL.folder, tmp_path, reasons=("calibration: exited with code 3",), exit_code=code)
    result = software_result(CELL, system, software(), outcome, tmp_path)
    assert (result.verdict, result.error) == ("fail", error)
    assert result.reasons == ("calibration: exited with code 3",)
