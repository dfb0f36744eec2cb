"""The stage collect of calibration.yml: datasets collected and calibrated beside the matrix, one verdict over both."""

import io
import json
from collections.abc import Callable
from pathlib import Path

import jsonschema
import pytest

from calibration.base import ExitCode, InputError
from calibration.ci.report import Report
from calibration.ci.workflow import Runner
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.report import report
from calibration.pipeline.report_tables import collections_table
from calibration.pipeline.results import SCHEMA_FILE, Collected, PipelineResults, read_results
from calibration.pipeline.running import PipelineRun, run_stages
from tests.pipeline.conftest import DATASETS
from tests.pipeline.matrix.test_cell_verdict import CELL
from tests.small import first_poses

CONFIGURATION = """
systems: {{riwbot: {{dataset: {datasets}/riwbot}}}}
simulation:
  small: {{system: {system}, motion: {motion}, limits: {{translation-mm: {limit}}}, minimum-collections: 3}}
"""


Configured = Callable[..., Path]


@pytest.fixture
def configured(small: Path, tmp_path: Path) -> Configured:
    """Write a calibration.yml with a limit and a motion, by default of three poses."""
    three = first_poses(small, 3, tmp_path / "three.json")

    def write(limit: str = "5", motion: Path = three) -> Path:
        path = tmp_path / "calibration.yml"
        path.write_text(CONFIGURATION.format(datasets=DATASETS, system=small, motion=motion, limit=limit))
        return path

    return write


def run(path: Path, output: Path, *stages: str) -> tuple[PipelineResults, str]:
    configuration = read_configuration(path)
    log = io.StringIO()
    runner = Runner(stdout=log, stderr=log)
    matrix = Matrix(configuration.systems, configuration.noise)
    asked = PipelineRun(matrix, output, runner, simulations=configuration.simulations, jobs=1)
    results = run_stages(asked, stages or ("calibrate", "introspect", "collect"))
    return results, log.getvalue()


def told(results: PipelineResults) -> Report:
    return report(results, Path("out"))


def test_collected_datasets_are_in_the_results(configured: Configured, tmp_path: Path) -> None:
    output = tmp_path / "output"
    results, log = run(configured(), output)
    assert results.verdict == "pass"
    assert told(results).line == "pass: 1 cell calibrated, 1 dataset collected"
    (collected,) = results.collections
    assert collected.kept == collected.poses == 3
    assert collected.dataset == "collected/small"
    assert (output / "collected" / "small" / "dataset.json").exists()
    assert "small      3 of 3 poses" in log
    document = json.loads((output / "results.json").read_text())
    jsonschema.validate(document, json.loads(SCHEMA_FILE.read_text()))
    assert read_results(output).collections == results.collections
    assert '<testsuite name="collected" tests="1" failures="0"' in (output / "junit.xml").read_text()
    results, _ = run(configured(), output)  # over what is there
    assert results.verdict == "pass"


def test_nothing_is_collected_for_a_dataset_that_is_not_there(configured: Configured, tmp_path: Path) -> None:
    path = configured()
    path.write_text(path.read_text().replace("/riwbot}", "/nowhere}"))
    with pytest.raises(InputError, match="nowhere: a dataset was expected"):
        run(path, tmp_path / "output", "collect", "calibrate", "introspect")
    assert not (tmp_path / "output").exists()


def test_red_in_simulation_is_red(configured: Configured, tmp_path: Path) -> None:
    results, log = run(configured(limit="0.000001"), tmp_path / "output")
    assert results.exit_code == ExitCode.FAIL
    assert "collected small: translation error against the truth: found" in log
    assert told(results).line == "fail: 1 of 1 dataset failed, 1 cell calibrated"
    assert "FAIL" in collections_table(results).rows[0][-1]


def test_what_cannot_be_collected_does_not_hide_the_rest(configured: Configured, tmp_path: Path) -> None:
    results, log = run(configured(motion=tmp_path / "no.json"), tmp_path / "output")
    assert results.exit_code == ExitCode.BAD_INPUT
    assert results.cells[0].verdict == "pass"
    assert "no.json" in log
    assert collections_table(results).rows == (("small", "0 of 0 poses", "-", "-", "FAIL"),)


def test_alone(configured: Configured, tmp_path: Path) -> None:
    results, log = run(configured(), tmp_path / "output", "collect")
    assert told(results).line == "pass: 1 dataset collected"
    assert "Start" not in log
    assert "Collected in simulation" in told(results).markdown()


def test_nothing_at_all_is_no_pass() -> None:
    assert PipelineResults().verdict == "fail"
    assert told(PipelineResults()).line == "fail: 0 of 0 cells failed"
    failed = Collected("a", reasons=("x",))
    assert PipelineResults((CELL,), collections=(failed,)).verdict == "fail"
    assert PipelineResults((CELL,), collections=(Collected("a"),)).verdict == "pass"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("simulation: {}", "simulation: found an empty mapping, expected a mapping of names"),
        ("simulation: {a: {}}", "simulation.a: expected a system, or containers"),
        ("simulation: {a: {system: x, motoin: y}}", "simulation.a: unknown key 'motoin': did you mean 'motion'"),
        (
            "simulation: {a: {system: x, minimum-coverage: 2}}",
            "simulation.a.minimum-coverage: found 2, expected a number",
        ),
        ("simulation: {../a: {system: x}}", "simulation: found the name '../a', expected letters"),
    ],
)
def test_a_wrong_simulation(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "calibration.yml"
    path.write_text(f"systems: {{a: {{dataset: b}}}}\n{text}\n")
    with pytest.raises(InputError) as error:
        read_configuration(path)
    assert message in str(error.value)
