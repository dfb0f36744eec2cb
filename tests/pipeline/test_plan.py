"""The jobs of a workflow for a configuration and the inputs, and their way through the outputs of a job."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.base.records import read
from calibration.ci.execution.job import Container
from calibration.ci.image.specification import ImageSpecification, parse_image_specification
from calibration.pipeline.collection.request import CollectionRequest
from calibration.pipeline.configuration import PipelineConfiguration
from calibration.pipeline.containers import Software
from calibration.pipeline.gathering import Needs, parse_needs
from calibration.pipeline.system import NoiseGrid, System
from calibration.pipeline.workflow_plan import (
    MAX_JOBS,
    MAX_OUTPUT_BYTES,
    JobCell,
    JobInputs,
    WorkflowPlan,
    datasets_as_configuration,
    plan_jobs,
    plan_of_text,
    plan_outputs,
    plan_text,
)

ROBOT, ARM = System("robot", Path("data/robot")), System("arm", Path("data/arm"))
FRESH = CollectionRequest(Path("data/robot"), name="fresh")
COLLECTED = replace(ROBOT, name="fresh", dataset=Path("simulation:fresh"))
GRID = NoiseGrid((0.0, 0.5), (0.0, 0.1), (1, 2))


def planned(
    *systems: System,
    simulations: tuple[CollectionRequest, ...] = (),
    section: ImageSpecification | None = None,
    noise: NoiseGrid = GRID,
    by_path: bool = False,
    **inputs: object,
) -> WorkflowPlan:
    configuration = PipelineConfiguration(systems=systems, simulations=simulations, image=section)
    inputs.setdefault("noise_inside_cells", False)
    return plan_jobs(configuration, systems, noise, JobInputs(**inputs), by_path=by_path)  # type: ignore[arg-type]


def image_section(push: bool, tmp_path: Path) -> ImageSpecification:
    entry = {"name": "ghcr.io/me/robot", "base": "debian", "push": push, "promote": ["stable", "v1"]}
    return parse_image_specification(entry, tmp_path, "image")


def software(image: str) -> Software:
    return Software(Container("calibration", image, ("calibrate",)))


def test_every_pair_of_noises_of_every_system_is_a_job() -> None:
    plan = planned(ROBOT, ARM)
    assert [cell.name for cell in plan.cells] == [
        f"{name}, {t} m, {r} rad" for name in ("robot", "arm") for t in ("0", "0.5") for r in ("0", "0.1")
    ]
    assert plan.cells[1].slug == "robot_0m_0.1rad"
    assert {
        (cell.noise.translation, cell.noise.rotation, cell.noise.seed) for cell in plan.cells[1].starts((1, 2))
    } == {
        (0.0, 0.1, 1),
        (0.0, 0.1, 2),
    }
    assert dict(plan.jobs) == {
        "image": False,
        "calibrate": True,
        "calibrate-in-image": False,
        "collect-data": False,
        "collect-data-in-containers": False,
        "calibrate-collected": False,
        "calibrate-collected-in-image": False,
        "test-image": False,
        "check-messages": False,
        "unit-tests": False,
        "static-analysis": False,
    }


def test_noise_inside_cells_makes_a_job_of_each_system() -> None:
    plan = planned(ROBOT, ARM, noise_inside_cells=True)
    assert [(cell.name, cell.slug) for cell in plan.cells] == [("robot", "robot"), ("arm", "arm")]
    assert len(plan.cells[0].starts(plan.seeds)) == 8


def test_one_job_calibrates_from_all_noises_where_that_is_short(tmp_path: Path) -> None:
    """By the size of the labels and the number of starts; a container's software has a job for each."""
    for name, size in (("small", 7_000_000), ("large", 9_000_000)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "dataset.json").write_bytes(bytes(size))
    small, large = (System(name, tmp_path / name) for name in ("small", "large"))
    contained = System("software", tmp_path / "small", software=software("robot:1"))

    def jobs(*systems: System, noise: NoiseGrid = GRID, **inputs: object) -> list[int]:
        plan = planned(*systems, noise=noise, noise_inside_cells=None, **inputs)
        return [sum(cell.system == system.name for cell in plan.cells) for system in systems]

    assert jobs(small, large, contained, ROBOT) == [1, 4, 4, 1]  # the last one's dataset is not there
    assert jobs(replace(small, dataset=tmp_path / "small" / "dataset.json")) == [1]
    assert jobs(small, noise=replace(GRID, seeds=(1, 2, 3))) == [4]
    assert jobs(small, command=True, image=True) == [4]


def test_the_largest_matrix_that_github_takes_and_one_more() -> None:
    systems = [replace(ROBOT, name=f"robot-{i}") for i in range(MAX_JOBS // 4)]
    assert len(planned(*systems).cells) == MAX_JOBS
    with pytest.raises(InputError, match=r"has 260 jobs \(65 systems x 2 .* x 2 .*\), .* 256: set noise-inside"):
        planned(*systems, ARM)
    many = [replace(ROBOT, name=f"robot-{i}") for i in range(MAX_JOBS + 1)]
    with pytest.raises(InputError, match=r"has 257 jobs .*: name fewer systems"):
        planned(*many, noise_inside_cells=True)


def test_systems_whose_dataset_is_collected_wait_for_it() -> None:
    plan = planned(ROBOT, COLLECTED, simulations=(FRESH,), noise_inside_cells=True, tests=True, analyse=True)
    assert {job: [cell.system for cell in cells] for job, cells in plan.cells_of_job.items() if cells} == {
        "calibrate": ["robot"],
        "calibrate-collected": ["fresh"],
    }
    assert plan.simulations == ("fresh",)
    assert [job for job, runs in plan.jobs.items() if runs] == [
        "calibrate",
        "collect-data",
        "calibrate-collected",
        "unit-tests",
        "static-analysis",
    ]
    with pytest.raises(InputError, match="'fresh' is made by the job collect-data: add that"):
        planned(ROBOT, COLLECTED, simulations=(FRESH,), jobs=("calibrate",))
    alone = planned(ROBOT, COLLECTED, simulations=(FRESH,), jobs=("collect-data",))
    assert alone.cells == ()


@pytest.mark.parametrize(
    ("jobs", "message"),
    [
        (("calibrat",), "there is no job 'calibrat': did you mean 'calibrate'\\?"),
        (("collect-data",), "nothing for collect-data to do: the configuration has no simulation"),
        (("calibrate", "unit-tests"), "nothing for unit-tests to do: the input tests is empty"),
        (("static-analysis",), "nothing for static-analysis to do: the configuration has no section analysis"),
    ],
)
def test_a_job_without_work_is_refused(jobs: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        planned(ROBOT, jobs=jobs)


def test_nothing_to_do_is_refused() -> None:
    with pytest.raises(InputError, match="there is nothing to do"):
        plan_jobs(None, (), NoiseGrid(), JobInputs(), by_path=False)
    only_tests = plan_jobs(None, (), NoiseGrid(), JobInputs(tests=True), by_path=False)
    assert [job for job, runs in only_tests.jobs.items() if runs] == ["unit-tests"]


@pytest.mark.parametrize(
    ("system", "inputs", "source"),
    [
        (ROBOT, {}, ""),
        (ROBOT, {"image": True}, ""),  # for the other systems, which have software
        (ROBOT, {"image": True, "command": True}, "given"),
        (replace(ROBOT, software=software("mine")), {}, "own"),
        (replace(ROBOT, software=software("mine")), {"image": True}, "given"),
        (replace(ROBOT, software=software("")), {}, "built"),
        (replace(ROBOT, software=software("")), {"image": True}, "given"),
    ],
)
def test_where_the_software_runs(system: System, inputs: dict[str, object], source: str, tmp_path: Path) -> None:
    plan = planned(system, section=image_section(True, tmp_path), **inputs)  # type: ignore[arg-type]
    assert plan.cells[0].image == source
    assert plan.image is (source == "built")


def test_the_image_is_built_before_only_where_the_cells_can_fetch_it(tmp_path: Path) -> None:
    system = replace(ROBOT, software=software(""))
    assert planned(system, section=image_section(True, tmp_path)).push
    for plan in (
        planned(system, section=image_section(False, tmp_path)),
        planned(system, section=image_section(True, tmp_path), push=False),  # a fork
    ):
        assert not plan.image
        assert not plan.push
        assert plan.promote == ()
    with pytest.raises(InputError, match="'robot' has no image to run it in: add the input image"):
        planned(ROBOT, command=True)


def test_what_was_tested_gets_its_tags_and_nothing_else(tmp_path: Path) -> None:
    section = image_section(True, tmp_path)
    system = replace(ROBOT, software=software(""))
    assert planned(system, section=section).promote == ("stable", "v1")
    assert planned(system, section=section, may_promote=False).promote == ()
    assert planned(ROBOT, section=section).promote == ()  # nothing has run in it
    assert planned(system, section=section, image=True).promote == ()  # nor here, where another one is given
    assert planned(system, section=replace(section, promote=())).promote == ()


@pytest.mark.parametrize(("image", "built"), [({}, True), ({"image": "mine"}, False)])
def test_a_simulation_needs_the_image_where_a_container_names_none(
    image: dict[str, str], built: bool, tmp_path: Path
) -> None:
    entry = {"containers": {"sim": {"command": ["simulate"], **image}}, "truth": "none"}
    simulations = (read(CollectionRequest, entry, "simulation", tmp_path, name="fresh"),)
    plan = planned(ROBOT, simulations=simulations, section=image_section(True, tmp_path))
    assert plan.image is built
    assert plan.collects_in_image is built
    fork = planned(simulations=simulations, section=image_section(True, tmp_path), push=False)
    assert (fork.image, fork.collects_in_image) == (False, built)


def test_datasets_are_systems_with_their_folders_name() -> None:
    configuration = datasets_as_configuration([Path("a/robot"), Path("b/arm/dataset.json")])
    assert [system.name for system in configuration.systems] == ["robot", "arm"]
    plan = planned(*configuration.systems, by_path=True)
    assert {cell.dataset for cell in plan.cells} == {"a/robot", "b/arm/dataset.json"}
    with pytest.raises(InputError, match="a/robot and b/robot are both called 'robot'"):
        datasets_as_configuration([Path("a/robot"), Path("b/robot")])


cells = st.builds(
    JobCell,
    name=st.text(max_size=20),
    slug=st.text(max_size=20),
    system=st.text(max_size=20),
    translations=st.lists(st.floats(0, 1000), min_size=1, max_size=3).map(tuple),
    rotations=st.lists(st.floats(0, 1000), min_size=1, max_size=3).map(tuple),
    dataset=st.text(max_size=20),
    image=st.sampled_from(["", "own", "built", "given"]),
)


@given(
    st.lists(cells, max_size=4),
    st.lists(cells.map(lambda cell: replace(cell, collected=True)), max_size=2),
    st.lists(st.integers(0, 10), min_size=1, unique=True),
    st.booleans(),
    st.none() | st.floats(0, 1000),
)
def test_a_plan_round_trips_through_its_file(
    now: list[JobCell], later: list[JobCell], seeds: list[int], flag: bool, rate: float | None
) -> None:
    plan = WorkflowPlan(
        (*now, *later),
        tuple(seeds),
        ("a", "b"),
        flag,
        image=flag,
        collects_in_image=flag,
        push=not flag,
        promote=("stable", "v1") if flag else (),
        minute_rate=rate,
    )
    outputs = plan_outputs(plan)
    assert all(value and "\n" not in value and "\r" not in value for value in outputs.values())
    assert plan_of_text(plan_text(plan), outputs["plan-sha256"]) == plan


def test_a_plan_that_is_another_one_is_refused() -> None:
    plan, other = planned(ROBOT), planned(ARM)
    for sha256 in (plan_outputs(other)["plan-sha256"], "", "0" * 64):
        with pytest.raises(InputError, match="another plan"):
            plan_of_text(plan_text(plan), sha256)


def test_the_largest_plan_can_travel_and_a_larger_one_is_refused() -> None:
    long = [replace(ROBOT, name=f"{i:03}".ljust(64, "x")) for i in range(MAX_JOBS)]
    assert plan_outputs(planned(*long, noise=NoiseGrid((0.123,), (0.123,))))
    longer = [replace(ROBOT, name=f"{i:03}".ljust(1000, "x")) for i in range(MAX_JOBS)]
    with pytest.raises(InputError, match=f"{MAX_OUTPUT_BYTES} is the limit: set noise-inside-cells: true, or shorten"):
        plan_outputs(planned(*longer, noise_inside_cells=True))


def test_every_cell_is_in_the_matrix_of_its_job() -> None:
    contained = System("software", Path("software"), software=software("robot:1"))
    outputs = plan_outputs(planned(ROBOT, COLLECTED, contained, simulations=(FRESH,), noise_inside_cells=True))
    cells = json.loads(outputs["cells"])
    found = {job.removesuffix("-names"): json.loads(text) for job, text in outputs.items() if job.endswith("-names")}
    assert found == {
        "calibrate": ["robot"],
        "calibrate-in-image": ["software"],
        "calibrate-collected": ["fresh"],
        "calibrate-collected-in-image": [],
    }
    assert {name: cell["slug"] for name, cell in cells.items()} == {
        name: name for name in ("robot", "fresh", "software")
    }


NO_NEEDS = ["", "[" * 100_000, "[]", "{}", '{"plan": 1}', '{"plan": {}}', "null", '{"a": {"result": "success"}}']


@pytest.mark.parametrize("text", NO_NEEDS)
def test_needs_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="needs: an object with every job was expected"):
        parse_needs(text)


def test_needs_of_a_plan_that_failed() -> None:
    text = '{"plan": {"result": "failure", "seconds": null, "error": "no file"}, "calibrate": {"result": "skipped"}}'
    assert parse_needs(text) == Needs({"plan": "failure", "calibrate": "skipped"}, {}, {"plan": "no file"})


def test_needs_whose_seconds_are_none() -> None:
    told = {"plan": "x", "image": "-1", "unit-tests": "12", "collect-data": 12}
    jobs = {name: {"result": "success", "seconds": seconds} for name, seconds in told.items()}
    assert parse_needs(json.dumps(jobs)).seconds == {"unit-tests": 12}
