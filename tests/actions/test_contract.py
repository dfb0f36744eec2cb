"""Holds every action.yml to the command it runs, and the locks to pyproject.toml."""

import ast
import json
import re
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path
from types import ModuleType
from typing import Any

import jsonschema
import pytest
import yaml

from benchmarks.action_start import INPUTS
from calibration.base.records import read
from calibration.commands.init import DEFAULT_SUITE
from calibration.robot.simulation.sensors import SimulatedCamera, SimulatedDepthCamera, SimulatedLidar
from calibration.robot.simulation.system import Simulation
from tests.lint.documents import made_whole, yaml_blocks

from .write_inputs import (
    COMMENT,
    FILES,
    PAGES,
    SHOWN,
    deprecated,
    described_keys,
    options,
    schema_file,
    with_inputs,
    with_parts,
)

PROJECT = Path(__file__).resolve().parents[2]
SUITE = DEFAULT_SUITE.partition("@")[0]
LOCKS = {path.name: path.read_text() for path in (PROJECT / "requirements").glob("*.txt")}


@pytest.fixture(params=FILES)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def action(name: str) -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load(FILES[name].read_text())
    return loaded


@pytest.fixture
def step(name: str, action: dict[str, Any]) -> dict[str, Any]:
    """Return the step that runs the action's command."""
    step, *further = action["runs"]["steps"]
    assert [each["name"] for each in further] == (["Comment"] if name == "run" else [])
    return dict(step)


def test_inputs_are_those_of_the_command(name: str, bootstrap: ModuleType) -> None:
    text = FILES[name].read_text()
    _, lock = bootstrap.ACTIONS[name]
    assert text == with_inputs(text, name, lock), "run `make actions`"


def test_pages_show_every_input_and_output() -> None:
    texts = [page.read_text() for page in PAGES]
    assert sorted(name for text in texts for name in re.findall(r"<!-- inputs: (\S+) -->", text)) == sorted(SHOWN)
    assert [page.name for page, text in zip(PAGES, texts, strict=True) if text != with_parts(text)] == [], (
        "run `make actions`"
    )


def test_pages_show_every_key_of_the_configuration_and_of_an_import() -> None:
    shown = [name for page in PAGES for name in re.findall(r"<!-- keys: (\S+) -->", page.read_text())]
    assert sorted(shown) == ["calibration.yml", "import.yml"]


def test_the_page_of_results_shows_keys_that_exist() -> None:
    page = (PROJECT / "docs" / "results-json.md").read_text()
    sections = [section for section in page.split("\n## ")[1:] if "\nSchema: " in section]
    assert len(sections) == 14
    for section in sections:
        [name] = re.findall(r"^Schema: \[`(.*)`\]", section, re.MULTILINE)
        assert f"(../{schema_file(name).relative_to(PROJECT).as_posix()})" in section
        shown = re.findall(r"^\| `(.*?)` \|", section, re.MULTILINE)
        assert shown
        assert set(shown) <= described_keys(name).keys(), name


def test_the_example_of_results_is_one() -> None:
    page = (PROJECT / "docs" / "results-json.md").read_text()
    [shown] = re.findall(r"^```json\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    jsonschema.validate(json.loads(shown), json.loads(schema_file("results").read_text()))


def test_every_input_reaches_its_option(name: str, action: dict[str, Any], step: dict[str, Any]) -> None:
    inputs = [each for each in action["inputs"] if name != "run" or each not in COMMENT]
    variables = {name: f"INPUT_{name.upper().replace('-', '_')}" for name in inputs}
    assert step["env"] == {variable: f"${{{{ inputs.{name} }}}}" for name, variable in variables.items()}
    # click reads the variable that it makes of the parameter's name; former names come before it.
    of_options = {option: f"INPUT_{(declared.name or '').upper()}" for option, declared in options(name).items()}
    former = {old: f"INPUT_{old.upper().replace('-', '_')}" for old in deprecated(name)}
    assert {**former, **of_options, "python": "INPUT_PYTHON"} == variables


def test_inputs_are_documented_and_have_their_default_in_python(action: dict[str, Any]) -> None:
    for entry in action["inputs"].values():
        assert entry["description"].endswith(".")
        assert entry.keys() <= {"description", "required"}  # a `default` here would be a second one


def test_outputs_have_a_value(action: dict[str, Any], step: dict[str, Any]) -> None:
    for name, entry in action["outputs"].items():
        assert entry["description"].endswith(".")
        assert entry["value"] == f"${{{{ steps.{step['id']}.outputs.{name} }}}}"


def test_the_step_is_one_line_of_bash_without_templates(name: str, step: dict[str, Any], bootstrap: ModuleType) -> None:
    folder = "actions" if name == "run" else ".."
    assert step["run"] == f'exec bash "$GITHUB_ACTION_PATH/{folder}/bootstrap.sh" {name}'
    assert step["shell"] == "bash"
    assert step.keys() == {"id", "run", "shell", "env"}  # no `uses`: act would fetch it, even where it is skipped
    entry, lock = bootstrap.ACTIONS[name]
    assert f'action_entry("{name}")' in (PROJECT / "actions" / entry).read_text()
    assert lock in LOCKS


def test_actions_present_themselves(action: dict[str, Any]) -> None:
    assert action["branding"].keys() == {"icon", "color"}
    assert action["description"].endswith(".")
    assert len(action["description"]) <= 125  # what the Marketplace shows


def test_every_action_of_bootstrap_has_its_file(bootstrap: ModuleType) -> None:
    assert set(bootstrap.ACTIONS) == set(FILES)


def test_the_start_of_every_action_is_measured() -> None:
    assert set(INPUTS) == set(FILES)


def test_old_pythons_read_bootstrap_far_enough_to_say_that_they_are_too_old() -> None:
    source = (PROJECT / "actions" / "bootstrap.py").read_text()
    ast.parse(source, feature_version=(3, 8))
    guard = source.index("if sys.version_info < (3, 11)")
    assert "|" not in "".join(re.findall(r"^def .*$", source[:guard], re.MULTILINE))


def test_locks_have_hashes_and_no_addresses() -> None:
    assert {name.removesuffix(".txt") for name in LOCKS} == {
        *("analysis", "introspect", "engine", "calibrate", "coverage", "github", "image", "run", "uv", "dev")
    }
    for text in LOCKS.values():
        assert not re.search(r"://|(?<!\w)/\w|^-", text, re.MULTILINE)
        for requirement in re.split(r"\n(?=\w)", text)[1:]:
            assert re.match(r"[\w.-]+(\[[\w,-]+\])?==\S+( ; [^\\]+)? \\\n    --hash=sha256:[0-9a-f]{64}", requirement)


def test_what_is_tested_is_what_the_actions_install(bootstrap: ModuleType) -> None:
    introspect, engine, calibrate, coverage, image, run, dev = (
        bootstrap.pins(PROJECT / "requirements" / f"{name}.txt")
        for name in ("introspect", "engine", "calibrate", "coverage", "image", "run", "dev")
    )
    assert bootstrap.covers(engine, introspect)
    assert bootstrap.covers(calibrate, engine)
    assert not {pin.partition("=")[0] for pin in engine} & {"boto3", "docker"}  # `make run` needs neither
    assert bootstrap.covers(run, [*calibrate, *image])
    assert bootstrap.covers(dev, [*run, *coverage])


def test_pip_and_the_actions_compare_with_the_same_opencv() -> None:
    """Another major version has other rows: OpenCV 5 goes on where 4 stops, and lacks the methods for arms."""
    packaging = pytest.importorskip("packaging.requirements")
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]
    [asked] = map(packaging.Requirement, project["optional-dependencies"]["opencv"])
    [locked] = re.findall(
        r"^opencv-python-headless==(\d+)", (PROJECT / "requirements/run.txt").read_text(), re.MULTILINE
    )
    assert not asked.specifier.contains(f"{int(locked) + 1}.0")
    assert asked.specifier.contains(f"{locked}.99")


@pytest.mark.parametrize(
    ("lock", "extras", "groups"),
    [
        ("introspect.txt", [], []),
        ("engine.txt", ["calibrate", "opencv"], []),
        ("calibrate.txt", ["calibrate", "opencv", "containers", "aws"], []),
        ("coverage.txt", ["coverage"], []),
        ("github.txt", ["github"], []),
        ("analysis.txt", ["analysis"], []),
        ("image.txt", ["containers", "aws"], []),
        ("run.txt", ["calibrate", "opencv", "bags", "figures", "containers", "aws", "requirements", "delivery"], []),
        ("dev.txt", ["opencv", "bags", "figures", "record"], ["dev"]),
    ],
)
def test_locks_satisfy_pyproject(lock: str, extras: list[str], groups: list[str]) -> None:
    packaging = pytest.importorskip("packaging.requirements")
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text())
    wanted = list(project["project"]["dependencies"])
    wanted += [line for extra in extras for line in project["project"]["optional-dependencies"][extra]]
    wanted += [line for group in groups for line in project["dependency-groups"][group]]
    locked: dict[str, list[str]] = {}
    for name, version in re.findall(r"^([\w.-]+)(?:\[[\w,-]+\])?==([^\s;]+)", LOCKS[lock], re.MULTILINE):
        locked.setdefault(name, []).append(version)
    for line in wanted:
        requirement = packaging.Requirement(line)
        versions = locked.get(re.sub(r"[-_.]+", "-", requirement.name).lower(), [])
        assert versions, f"{line}: not in requirements/{lock}, run `make lock`"
        assert all(map(requirement.specifier.contains, versions)), f"{line}: {versions}, run `make lock`"


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize(
    ("lock", "extras"),
    [
        ("introspect.txt", []),
        ("engine.txt", ["calibrate"]),
        ("calibrate.txt", ["calibrate"]),
        ("run.txt", ["calibrate"]),
        ("coverage.txt", ["coverage"]),
        ("github.txt", ["github"]),
    ],
)
def test_an_interpreter_of_ones_own_is_asked_for_all_modules(
    bootstrap: ModuleType, lock: str, extras: list[str]
) -> None:
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]
    wanted = project["dependencies"] + [line for extra in extras for line in project["optional-dependencies"][extra]]
    names = {re.split(r"[<>=\[;]", line)[0].lower() for line in wanted}
    modules = packages_distributions()
    assert {modules[module][0].lower() for module in bootstrap.MODULES[lock]} == names


@pytest.fixture
def examples() -> list[Any]:
    """What the README and the pages show in YAML."""
    return [yaml.safe_load(text) for page in PAGES for _, text in yaml_blocks(page.read_text())]


TOKEN = "codacy-project-token"  # noqa: S105 (its name)


def test_tokens_in_examples_are_used(examples: list[Any]) -> None:
    """Both say who is told of the coverage; without that a token is an error, or is not used."""
    jobs = [
        job
        for example in examples
        if "jobs" in example
        for job in example["jobs"].values()
        if TOKEN in job.get("secrets", {})
    ]
    steps = [each for example in examples if isinstance(example, list) for each in example]
    uploads = [step["with"] for step in steps if "coverage-upload" in step.get("uses", "")]
    assert jobs
    assert uploads
    assert {job["with"]["coverage-service"] for job in jobs} == {step["service"] for step in uploads} == {"codacy"}


def test_steps_in_examples_have_what_their_actions_require(examples: list[Any]) -> None:
    """GitHub does not ask for it: the action would, after it has installed its packages."""
    jobs = [job for example in examples if isinstance(example, dict) for job in example.get("jobs", {}).values()]
    steps = [step for job in jobs for step in job.get("steps", [])]
    steps += [step for example in examples if isinstance(example, list) for step in example]
    used = [
        (found[1], step.get("with", {}))
        for step in steps
        if (found := re.search(r"/actions/([\w-]+)@v1$", step.get("uses", "")))
    ]
    assert len(used) > 5
    for name, given in used:
        inputs = yaml.safe_load(FILES[name].read_text())["inputs"]
        assert given.keys() <= inputs.keys()
        assert {key for key, entry in inputs.items() if entry.get("required")} <= given.keys(), name


def test_examples_call_the_reusable_workflow_right(examples: list[Any]) -> None:
    called = yaml.safe_load((PROJECT / ".github" / "workflows" / "pipeline.yml").read_text())[True]["workflow_call"]
    jobs = [job for example in examples if "jobs" in example for job in example["jobs"].values() if "uses" in job]
    assert jobs
    for job in jobs:
        assert job["uses"] == f"{SUITE}/.github/workflows/pipeline.yml@v1"
        assert set(job.get("with", {})) <= set(called["inputs"]) - deprecated("plan-matrix").keys()
        assert set(job.get("secrets", {})) <= set(called["secrets"])


def test_every_action_has_an_example_and_each_is_right(examples: list[Any]) -> None:
    steps = [step for example in examples if isinstance(example, list) for step in example]
    steps += [s for e in examples if "jobs" in e for job in e["jobs"].values() for s in job.get("steps", [])]
    used = set()
    for step in steps:
        if step.get("uses", "").startswith(SUITE):
            path, _, tag = step["uses"].partition("@")
            name = path.partition("/actions/")[2] or "run"
            assert (path, tag) == (SUITE + (f"/actions/{name}" if name != "run" else ""), "v1")
            known = {*options(name), *(COMMENT if name == "run" else ())} - deprecated(name).keys()
            assert set(step.get("with", {})) <= known
            used.add(name)
    assert used == set(FILES)


def test_configurations_in_examples_are_right(examples: list[Any]) -> None:
    schema = json.loads((PROJECT / "calibration/pipeline/calibration.schema.json").read_text())
    kinds = [(*made_whole(example), example) for example in examples]
    configurations = [document for kind, document, _ in kinds if kind == "calibration.yml"]
    assert len(configurations) >= 3
    for document in configurations:
        jsonschema.validate(document, schema)
    page = PROJECT / "docs" / "collect-data-sim.md"
    [simulation] = [part for _, text in yaml_blocks(page.read_text()) if "sensors" in (part := yaml.safe_load(text))]
    described = read(Simulation, simulation, page.name)
    sensors = described.sensors
    assert read(SimulatedCamera, sensors["left_camera"], "left_camera").camera.distortion.k1 == -0.1
    assert read(SimulatedDepthCamera, sensors["depth"], "depth").most_range == 6.5
    assert len(read(SimulatedLidar, sensors["lidar"], "lidar").elevations) == 16
    assert described.scene.boxes[0].colour == (170, 160, 150)
