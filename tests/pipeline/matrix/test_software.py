"""The team's software in a cell: what it is told, and what its files say."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from calibration.dataset.reading import read_dataset
from calibration.errors import ExitCode, InputError
from calibration.estimation.calibrate import calibrate
from calibration.estimation.starting_noise import StartingNoise, with_starting_noise
from calibration.execution.job import OUTPUT, Artifact
from calibration.execution.outcome import BroughtOut, JobOutcome
from calibration.pipeline.matrix.cell import Cell, CellResult
from calibration.pipeline.matrix.matrix import load
from calibration.pipeline.matrix.software import (
    DATASET,
    START,
    Software,
    adjusted_software,
    software_from,
)
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
    assert container.command == ("run", START, "-o", f"{OUTPUT}/x y", "0.5:0.1", "7")
    assert [(m.source, m.target, m.writable) for m in container.mounts] == [
        (DATASETS / "t2rgb", DATASET, False),
        (DATASETS, START, False),
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
def test_what_is_wrong_is_said_before_anything_runs(entry: dict[str, object], message: str) -> None:
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


@pytest.fixture
def result_of(tmp_path: Path) -> Callable[..., CellResult]:
    def judged(files: dict[str, str | Path], asked: Software | None = None, evaluate: str | None = None) -> CellResult:
        system = load(System("t2rgb", DATASETS / "t2rgb", evaluate=evaluate))
        folder = tmp_path / CELL.folder
        for name, content in files.items():
            path = folder / "artifacts" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, Path):
                shutil.copy(content, path)
            else:
                path.write_text(content)
        artifacts = tuple(BroughtOut(name, "calibration", 1, "") for name in files)
        outcome = JobOutcome(CELL.folder, folder, artifacts=artifacts, seconds=1.0)
        return software_result(CELL, system, asked or software(), outcome, tmp_path)

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
def test_a_table_that_says_nothing_is_no_pass(
    result_of: Callable[..., CellResult], files: dict[str, str], message: str
) -> None:
    result = result_of(files)
    assert result.verdict == "fail"
    assert result.error is None
    assert message in result.reasons[0]


def test_one_of_several_tables_is_named(result_of: Callable[..., CellResult]) -> None:
    result = result_of({"a.csv": TABLE, "b.csv": TABLE.replace("0.25", "0.5")}, software(table="b.csv"))
    assert result.rms_px == 0.5


def test_a_calibrated_dataset_is_held_against_the_truth(result_of: Callable[..., CellResult], tmp_path: Path) -> None:
    from calibration.dataset.writing import write_dataset

    path = write_dataset(calibrate(read_dataset(DATASETS / "t2rgb")).dataset, tmp_path / "ours", images=False)
    asked = software(calibrated="*.json")
    result = result_of({"calibrated.json": path, "t.csv": TABLE}, asked)
    assert result.verdict == "pass"
    assert result.truth is not None
    assert result.truth.translation_mm < 0.1
    assert result.rms_px == 0.25  # its own table is the one that is judged
    noisy = with_starting_noise(read_dataset(DATASETS / "t2rgb"), CELL.noise)
    wrong = result_of({"calibrated.json": write_dataset(noisy, tmp_path / "n", images=False), "t.csv": TABLE}, asked)
    assert wrong.truth is not None
    assert wrong.truth.translation_mm > 100


def test_without_a_table_of_its_own_we_evaluate_its_dataset(result_of: Callable[..., CellResult]) -> None:
    asked = software(calibrated="dataset.json")
    evaluate = "rgb-to-rgb:right_camera:left_camera"
    result = result_of({"dataset.json": DATASETS / "t2rgb" / "dataset.json"}, asked, evaluate)
    assert result.table == f"{CELL.folder}/rgb_to_rgb_results.csv"
    assert result.rms_px is not None
    assert 0.05 < result.rms_px < 0.2


@pytest.mark.parametrize("content", ["{", "[]", '{"collections": {}}'])
def test_a_calibrated_dataset_that_is_none_has_failed(result_of: Callable[..., CellResult], content: str) -> None:
    result = result_of({"d.json": content, "t.csv": TABLE}, software(calibrated="d.json"))
    assert (result.verdict, result.error) == ("fail", None)
    assert "d.json" in result.reasons[0]


@pytest.mark.parametrize(
    ("code", "error"),
    [(ExitCode.FAIL, None), (ExitCode.BAD_INPUT, ExitCode.BAD_INPUT), (ExitCode.WORLD, ExitCode.WORLD)],
)
def test_a_job_that_failed_says_why(tmp_path: Path, code: ExitCode, error: ExitCode | None) -> None:
    system = load(System("t2rgb", DATASETS / "t2rgb"))
    outcome = JobOutcome(CELL.folder, tmp_path, reasons=("calibration: exited with code 3",), exit_code=code)
    result = software_result(CELL, system, software(), outcome, tmp_path)
    assert (result.verdict, result.error) == ("fail", error)
    assert result.reasons == ("calibration: exited with code 3",)
