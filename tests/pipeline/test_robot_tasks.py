"""``tasks`` of a system: read, refused, judged, and in every file of a run."""

import json
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.base import InputError
from calibration.engine.baseline.calibration_document import TaskDocument
from calibration.engine.diagnosis.finding import Finding
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.matrix.cell_details import judged_tasks
from calibration.pipeline.matrix.cell_result import TaskResult

DATASET = Path(__file__).parents[2] / "datasets" / "riwbot"
GRASP = "grasp: {seen-by: rgb_world, in: flange, distance: 1, limit-mm: 3}"
TIP = "tip: {of: flange, in: base_link, points: [[0, 0, 0.1]], limit-mm: 0.01}"


def write(folder: Path, tasks: str, more: str = "") -> Path:
    path = folder / "calibration.yml"
    path.write_text(f"systems: {{arm: {{dataset: '{DATASET}', truth: none, exports: {{}}{more}, tasks: {{{tasks}}}}}}}")
    return path


def test_they_are_read(tmp_path: Path) -> None:
    """By name; one sensor needs no list; a limit on a task is one of the system's."""
    [system] = read_configuration(write(tmp_path, f"{GRASP}, seen: {{seen-by: [a, b], distance: 2}}")).systems
    grasp, seen = system.tasks
    assert (grasp.name, grasp.seen_by, grasp.frame, grasp.limit, grasp.unit) == (
        "grasp",
        ("rgb_world",),
        "flange",
        3,
        "mm",
    )
    assert (seen.seen_by, seen.limit) == (("a", "b"), None)
    assert system.judging_limits.any_set
    assert not system.limits.any_set


@pytest.mark.parametrize(
    ("task", "said"),
    [
        ("{distance: 1}", "seen-by"),
        ("{seen-by: a}", "points"),
        ("{seen-by: a, of: b, distance: 1}", "of"),
        ("{seen-by: a, distance: 1, points: [[0, 0, 1]]}", "distance"),
        ("{seen-by: a, distance: 0}", "distance"),
        ("{seen-by: a, points: [[0, 0]]}", "points"),
        ("{seen-by: a, points: [[0, 0, .inf]]}", "points"),
        ("{seen-by: a, distance: 1, limit-mm: 0}", "limit-mm"),
        ("{seen-by: a, distance: 1, limit-px: 1}", "limit-mm"),
        ("{seen-by: a, in-image-of: b, distance: 1, limit-mm: 1}", "limit-px"),
        ("{seen-by: a, distance: 1, limit-mm: 1, limit-deg: 1}", "limit-deg"),
        ("{seen-by: a, in: b, in-image-of: c, distance: 1}", "in"),
        ("{of: a, points: [[0, 0, 0]]}", "of"),
        ("{seen-by: [a, b], on-plane: c, points: [[0, 0, 0]]}", "on-plane"),
        ("{seen-by: a, distance: 1, limit: 2}", "limit"),
    ],
)
def test_keys_that_do_not_go_together_are_named(tmp_path: Path, task: str, said: str) -> None:
    """Where they are, and which."""
    with pytest.raises(InputError, match=rf"systems\.arm\.tasks\.work.*{said}"):
        read_configuration(write(tmp_path, f"work: {task}"))


def test_a_frame_that_the_robot_has_not_is_wrong_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2, one line, before anything is calibrated."""
    path = write(tmp_path, "grasp: {seen-by: rgb_world, in: claw, distance: 1}")
    assert main(["run", "--config", str(path), "--output", str(tmp_path / "output")]) == 2
    said = capsys.readouterr()
    assert "systems.arm.tasks.grasp.in: frame 'claw'" in said.err + said.out


def test_a_point_that_the_camera_does_not_see_is_wrong_input(tmp_path: Path) -> None:
    """Known once it is calibrated: exit code 2."""
    path = write(tmp_path, "grasp: {seen-by: rgb_world, in-image-of: rgb_world, points: [[0, 0, -1]]}")
    output = tmp_path / "output"
    assert main(["run", "--config", str(path), "--output", str(output)]) == 2
    assert "behind" in (output / "results.json").read_text()


def test_a_run_judges_them_and_tells_of_them_everywhere(tmp_path: Path) -> None:
    """One that holds, one that is undecided: results, summary, page, export."""
    path, output = write(tmp_path, f"{GRASP}, {TIP}", ", undecided: pass"), tmp_path / "output"
    assert main(["run", "--config", str(path), "--output", str(output), "--jobs", "1"]) == 0
    [cell] = json.loads((output / "results.json").read_text())["cells"]
    states = {each["name"]: (each["state"], each["unit"], each["median"] < each["most"]) for each in cell["tasks"]}
    assert states == {"grasp": ("holds", "mm", True), "tip": ("undecided", "mm", True)}
    assert cell["verdict"] == "undecided"
    [own] = json.loads((output / cell["folder"] / "results.json").read_text())["cells"]
    over_image, in_space = own["task_maps"]
    assert len(over_image["points"]) == 63 == len(over_image["most"])
    assert (over_image["columns"], in_space["columns"]) == (9, None)
    assert "arm: grasp" in (output / "summary.md").read_text()
    page = (output / "report.html").read_text()
    assert "How far off the robot is where it works" in page
    [exported] = output.rglob("exports/calibration.json")
    tasks = json.loads(exported.read_text())["calibration"]["tasks"]
    assert tasks["grasp"]["limit"] == 3
    assert tasks["tip"]["most"] > 0.01
    assert TaskDocument(**tasks["tip"]).unit == "mm"


def test_against_a_truth_their_own_error_counts(tmp_path: Path) -> None:
    """Without other errors than labels' each point is far within what is stated; a limit below its error is broken."""
    tight = GRASP.replace("grasp", "tight").replace("limit-mm: 3", "limit-mm: 0.0001")
    path, output = write(tmp_path, f"{GRASP}, {tight}"), tmp_path / "output"
    path.write_text(path.read_text().replace("truth: none, ", ""))
    assert main(["calibrate-matrix", "--config", str(path), "--output", str(output), "--jobs", "1"]) == 1
    [cell] = json.loads((output / "results.json").read_text())["cells"]
    grasp, broken = cell["tasks"]
    assert (grasp["state"], grasp["within"], grasp["truth"] < grasp["most"]) == ("holds", 1.0, True)
    assert (broken["state"], broken["truth"] > 0.0001) == ("broken", True)
    assert any(each.startswith("error of task 'tight' against the truth") for each in cell["reasons"])
    assert f"true {grasp['truth']:.3g} at most, 100% within" in (output / "summary.md").read_text()


def test_a_task_is_broken_by_what_is_red_and_names_it() -> None:
    """Else undecided by its error, or it holds; without a limit nothing is said."""
    each = {"unit": "mm", "median": 0.5, "typical": 0.4, "worst": "", "parts": (), "frame": "tool"}
    tasks = (
        TaskResult(name="a", limit=2.0, most=1.0, **each),  # type: ignore[arg-type]
        TaskResult(name="b", limit=2.0, most=3.0, **each),  # type: ignore[arg-type]
        TaskResult(name="c", limit=2.0, most=1.0, **each),  # type: ignore[arg-type]
        TaskResult(name="d", most=1.0, **each),  # type: ignore[arg-type]
    )
    judged = judged_tasks(
        tasks, [Finding("suspect", "red", "", tasks=("c",)), Finding("task", "note", "", tasks=("a",))]
    )
    assert [task.state for task in judged] == ["holds", "undecided", "broken", None]
