"""The README's picture is of a real run, and what the READMEs point to is there."""

import json
import re
import shlex
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

from benchmarks.run_picture import LINE, PICTURE, drawing, tables
from calibration.__main__ import load_command, main
from calibration.base import InputError
from calibration.base.records import flat_fields
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.options import Assumptions
from tests.actions.write_inputs import anchor

from .documents import READMES
from .yaml_lines import PROJECT

ROBOMAKER = (
    *("iamRole", "maxJobDurationInSeconds", "failureBehavior", "clientRequestToken", "outputLocation", "loggingConfig"),
    *("tags", "robotApplications", "simulationApplications", "dataSources", "compute", "vpcConfig", "batchPolicy"),
    *("launchConfig", "packageName", "environmentVariables", "portForwardingConfig", "streamUI", "tools"),
    *("uploadConfigurations", "worldConfigs", "createSimulationJobRequests", "assignPublicIp", "maxConcurrency"),
)
"""What CreateSimulationJob and StartSimulationJobBatch took."""
TEXT = "{http://www.w3.org/2000/svg}text"


@pytest.fixture(scope="module")
def lines() -> list[str]:
    """What stands in the picture, with its empty lines."""
    found = [(int(text.get("y", "")), str(text.text)) for text in ET.parse(PICTURE).iter(TEXT)]  # noqa: S314
    first, last = found[0][0], found[-1][0]
    by_place = {(y - first) // LINE: line for y, line in found}
    return [by_place.get(number, "") for number in range((last - first) // LINE + 1)]


def errors(lines: list[str]) -> list[list[float]]:
    """The numbers of the last system in the rows of our engine: pixels, millimetres, degrees."""
    last = max(number for number, line in enumerate(lines) if line.startswith("Start "))
    rows = [line for line in lines[last:] if re.match(r"[\d.]+ m, [\d.]+ rad ", line)]
    cells = [re.findall(r"([\d.]+) px, ([\d.]+) mm, ([\d.]+) deg", row)[-1] for row in rows]
    return [[float(number) for number in cell] for cell in cells]


def test_the_picture_needs_nothing_from_elsewhere() -> None:
    text = PICTURE.read_text()
    assert "://" not in text.replace("http://www.w3.org/2000/svg", "", 1)
    assert not re.search(r"@import|@font-face|url\(|href|<script|<image|<foreignObject", text)


def test_the_picture_is_drawn_not_edited(lines: list[str]) -> None:
    assert drawing("\n".join(lines)) == PICTURE.read_text()


def test_the_picture_shows_every_system_and_the_verdict(lines: list[str]) -> None:
    configuration = yaml.safe_load((PROJECT / "calibration.yml").read_text())
    assert lines[0] == "$ calibration run"
    headers = [line.split() for line in lines if line.startswith("Start ")]
    assert [system for header in headers for system in header[1:]] == list(configuration["systems"])
    for name in configuration["simulation"]:
        assert any(line.startswith(f"{name} ") for line in lines)
    assert lines[-1].startswith("pass: ")


def test_the_picture_shows_what_a_run_prints(
    lines: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    configuration = yaml.safe_load((PROJECT / "calibration.yml").read_text())
    name, system = list(configuration["systems"].items())[-1]
    (tmp_path / "datasets").symlink_to(PROJECT / "datasets")
    document = {"noise": configuration["noise"], "systems": {name: {**system, "compare": []}}}
    (tmp_path / "calibration.yml").write_text(yaml.safe_dump(document))
    monkeypatch.chdir(tmp_path)

    assert main(["run", "--jobs", "1"]) == 0

    printed = tables(capsys.readouterr().out).splitlines()
    assert printed[0].split() == ["Start", name]
    assert len(errors(printed)) == 4
    assert errors(lines) == [pytest.approx(row, rel=0.05) for row in errors(printed)]


def test_what_does_not_fit_into_a_picture_as_it_is_is_escaped() -> None:
    drawn = drawing("$ a <b> & c\nfail: x < y")
    assert "a &lt;b&gt; &amp; c" in drawn
    assert 'class="fail"' in drawn


@pytest.mark.parametrize("readme", READMES, ids=lambda path: str(path.relative_to(PROJECT)))
def test_what_a_page_points_to_is_there(readme: Path) -> None:
    for link, _, at in re.findall(r"\]\(([^)#]*)(#([^)]*))?\)", readme.read_text()):
        if "://" not in link:
            page = readme.parent / link if link else readme
            assert page.exists(), link
            assert not at or at in anchors(page), f"{link}#{at}"


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings."""
    return {anchor(title) for title in re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)}


def commands() -> list[str]:
    """The lines of the pages that run a command of ours."""
    blocks = [
        block
        for page in READMES
        for block in re.findall(r"^ *```\w*\n(.*?)^ *```", page.read_text(), re.DOTALL | re.MULTILINE)
    ]
    lines = [line.strip().removeprefix("$ ") for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    return sorted({line for line in lines if line.startswith("calibration ")})


@pytest.mark.parametrize("line", commands())
def test_commands_in_pages_have_the_options_that_they_use(line: str) -> None:
    _, name, *arguments = shlex.split(line, comments=True)
    if name == "--help":
        return
    load_command(name).make_context(name, arguments)  # an error where an option is unknown, wrong or missing


def test_the_library_s_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    [shown] = re.findall(r"^```python\n(.*?)^```", (PROJECT / "docs/library.md").read_text(), re.DOTALL | re.MULTILINE)
    program = shown.replace('"data/my_robot"', repr(str(PROJECT / "datasets" / "t2rgb")))
    assert program != shown
    exec(compile(program, "docs/library.md", "exec"), {})  # noqa: S102 (our own page)
    assert capsys.readouterr().out.startswith("camera_")


def test_every_page_is_in_the_index() -> None:
    index = (PROJECT / "docs" / "README.md").read_text()
    pages = [page.name for page in PROJECT.glob("docs/*.md") if page.name != "README.md"]
    assert [name for name in pages if f"({name})" not in index] == []


def test_the_readme_is_short() -> None:
    assert len((PROJECT / "README.md").read_text().splitlines()) < 180


def test_the_smallest_dataset_is_one(tmp_path: Path) -> None:
    [shown] = re.findall(r"^```json\n(.*?)^```", (PROJECT / "docs/dataset.md").read_text(), re.DOTALL | re.MULTILINE)
    (tmp_path / "dataset.json").write_text(shown)
    dataset = read_dataset(tmp_path)
    assert list(dataset.sensors) == ["left", "right"]
    document = json.loads(shown)
    for name in ("_metadata", "calibration_config", "sensors", "collections"):
        (tmp_path / "dataset.json").write_text(json.dumps({k: v for k, v in document.items() if k != name}))
        with pytest.raises(InputError, match=name):
            read_dataset(tmp_path)


def test_every_assumption_is_described() -> None:
    text = (PROJECT / "docs" / "verdict.md").read_text()
    assert [key for key in flat_fields(Assumptions) if f"`{key}`" not in text] == []


def test_every_field_of_a_simulation_job_has_its_place_or_a_reason() -> None:
    text = (PROJECT / "docs" / "aws-batch.md").read_text()
    table = text.partition("## From RoboMaker")[2].partition("## What only an emulator has seen")[0]
    assert [field for field in ROBOMAKER if field not in table] == []
