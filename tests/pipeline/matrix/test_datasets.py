"""What a cell keeps of its calibrated dataset: all of it, only the changes, or nothing but the results."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from calibration.base import InputError
from calibration.ci.workflow import Runner
from calibration.pipeline.matrix.loaded_system import load
from calibration.pipeline.matrix.matrix import Matrix
from calibration.pipeline.results import PipelineResults, clear_results, own_file, results_of
from calibration.pipeline.running import PipelineRun, run_stages
from calibration.pipeline.system import Datasets, Exports, NoiseGrid, System
from tests.pipeline.conftest import DATASETS, RIWBOT, T2RGB


def run(output: Path, system: System, datasets: Datasets, *stages: str) -> PipelineResults:
    """Run a matrix of two starts."""
    matrix = Matrix((replace(system, datasets=datasets),), NoiseGrid((0.1,), (0.1,), (1, 2)))
    return run_stages(PipelineRun(matrix, output, Runner(), jobs=1), stages or ("calibrate", "introspect"))


@pytest.mark.parametrize("system", [T2RGB, RIWBOT])
def test_the_results_do_not_depend_on_it(system: System, tmp_path: Path) -> None:
    found = {each: run(tmp_path / each, system, each).cells for each in ("full", "changes", "none")}
    same = [[replace(cell, dataset=None, seconds=0.0) for cell in cells] for cells in found.values()]
    assert same[0] == same[1] == same[2]
    assert [cell.dataset is None for cell in found["none"]] == [True, True]
    whole, changes = (tmp_path / name / str(found[name][0].dataset) for name in ("full", "changes"))
    assert 20 * changes.stat().st_size < whole.stat().st_size
    assert not [*(tmp_path / "none").rglob("dataset.json")]


def test_only_a_whole_dataset_has_its_point_clouds_beside_it(tmp_path: Path) -> None:
    for datasets in ("full", "changes"):
        [cell, _] = run(tmp_path / datasets, System("rlbot", DATASETS / "rlbot"), datasets, "calibrate").cells
        clouds = {path.name for path in (tmp_path / datasets / str(cell.dataset)).parent.glob("*.pcd")}
        expected = {path.name for path in (DATASETS / "rlbot").glob("*.pcd")} if datasets == "full" else set()
        assert clouds == expected


def test_the_page_shows_the_same_with_changes_and_says_why_it_shows_nothing(tmp_path: Path) -> None:
    pages = {}
    for each in ("full", "changes", "none"):
        run(tmp_path / each, T2RGB, each)
        pages[each] = re.sub(r"\d+(\.\d+)? s\b", "", (tmp_path / each / "report.html").read_text())
    assert pages["full"] == pages["changes"]
    assert "No figures: the dataset is not kept (datasets: none)." in pages["none"]
    assert "No figures" not in pages["full"]


def test_what_a_robot_gets_is_the_same_with_changes_and_refused_without_datasets(tmp_path: Path) -> None:
    system, stages = replace(T2RGB, exports=Exports()), ("calibrate", "introspect", "export")
    files = []
    for each in ("full", "changes"):
        [found] = run(tmp_path / each, system, each, *stages).exports
        assert found.files
        files.append({name: (tmp_path / each / found.folder / name).read_bytes() for name in found.files})
    assert files[0] == files[1]
    with pytest.raises(InputError, match=r"^systems.t2rgb.datasets: found none, expected changes or full: it has exp"):
        run(tmp_path / "none", system, "none", *stages)


@pytest.mark.parametrize("datasets", ["full", "none"])
def test_the_cells_own_results_are_found_and_cleared_without_a_dataset(datasets: Datasets, tmp_path: Path) -> None:
    [cell, _] = run(tmp_path, T2RGB, datasets).cells
    [whole, _] = results_of(tmp_path).cells
    assert whole.details is not None
    assert whole.details.snapshot is not None
    assert own_file(cell) == own_file(whole) == f"{cell.folder}/results.json"
    clear_results(tmp_path)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_results_of_an_older_version_name_no_folder(tmp_path: Path) -> None:
    run(tmp_path, T2RGB, "full")
    path = tmp_path / "results.json"
    document = json.loads(path.read_text())
    for cell in document["cells"]:
        del cell["folder"]
    path.write_text(json.dumps(document))
    assert all(cell.details is not None and cell.folder is None for cell in results_of(tmp_path).cells)


def test_changes_refer_to_a_whole_dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(DATASETS.parent)
    [cell, _] = run(tmp_path, T2RGB, "changes").cells
    system = replace(T2RGB, dataset=tmp_path / str(cell.dataset))
    assert load(replace(system, datasets="full")).dataset.keys
    with pytest.raises(InputError, match="found changes, which need a whole dataset to refer to: say datasets: full"):
        load(replace(system, datasets="changes"))
