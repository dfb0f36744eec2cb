"""The life of a robot whose team has a URDF, a bag and its own software, and no truth: from the bag to pull requests.

Import, first configuration, accepted calibration; then changes that damage the calibration, each red with its cause,
and one that does not. The workflow is the one that ``init`` writes; GitHub's API is a stand-in.
"""

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml

from calibration.pipeline.results import read_results
from tests.ci.github.stand_in import TOKEN, GitHub, github
from tests.repositories import git
from tests.robot.importing.arm import ON_FLANGE, SYSTEM, keys, record_arm

from .conftest import FORK, Repository, Run, calibration, commit
from .pipeline import Caller

IMPORT = {"bags": {"files": ["poses.bag"], "robot-description": "robot.urdf"}, "patterns": {"board": ON_FLANGE}}
SOFTWARE = """
import json, sys
start, output, shift = sys.argv[1], sys.argv[2], float(sys.argv[3])
document = json.load(open(start + "/dataset.json"))
for collection in document["collections"].values():
    collection["transforms"].update(json.loads(json.dumps(FOUND)))
    collection["transforms"][EDGE]["trans"][0] += shift
json.dump(document, open(output + "/dataset.json", "w"))
open(output + "/table.csv", "w").write("Collection #,RMS (pix)\\n000,RMS\\nAverages,RMS\\n")
"""
"""A team's solver, which knows the answer: it puts the camera so many metres beside it."""
CAMERA, PATTERN = "tripod_center_support-rgb_world_link", "flange-board_link"


@pytest.fixture
def caller(repository: Repository, tmp_path: Path) -> Caller:
    return Caller(repository, tmp_path / "artifacts")


@pytest.fixture
def api(caller: Caller) -> Iterator[GitHub]:
    """GitHub's API."""
    with github() as found:
        found.repository = f"me/{caller.repository.folder.name.replace(' ', '-')}"
        yield found


def import_again(folder: Path) -> None:
    calibration(folder, "import-data", "--config", "import.yml", "--output", "data/robot", "--overwrite")


def with_software(folder: Path, image: str, shift: float) -> None:
    """Let the team's solver calibrate the robot."""
    path = folder / "calibration.yml"
    document = yaml.safe_load(path.read_text())
    results = read_results(folder / "output")
    [cell] = [each for each in (*results.cells, *results.comparisons) if each.method == "calibration-ci"]
    assert cell.dataset is not None
    transforms = json.loads((folder / "output" / cell.dataset).read_text())["collections"]["000"]["transforms"]
    program = SOFTWARE.replace("FOUND", repr({edge: transforms[edge] for edge in (CAMERA, PATTERN)}))
    program = program.replace("EDGE", repr(CAMERA)).replace("000,RMS", f"000,{cell.rms_px}")
    program = program.replace("Averages,RMS", f"Averages,{cell.rms_px}").replace("{", "{{").replace("}", "}}")
    command = ["python3", "-c", program, "{start}", "{output}", str(shift)]
    document["systems"]["robot"]["software"] = {"image": image, "command": command, "calibrated": "dataset.json"}
    path.write_text(yaml.safe_dump(document))


def longer_upper_arm(folder: Path, image: str) -> None:
    urdf = folder / "robot.urdf"
    urdf.write_text(urdf.read_text().replace('xyz="-0.6127 0 0"', 'xyz="-0.6177 0 0"'))
    import_again(folder)


def other_camera_info(folder: Path, image: str) -> None:
    (folder / "poses.bag").unlink()
    record_arm(folder / "poses.bag", "bag", keys()[::2], encoding="jpeg", focal=1.01, urdf=False)
    import_again(folder)


def other_recording(folder: Path, image: str) -> None:
    (folder / "poses.bag").unlink()
    record_arm(folder / "poses.bag", "bag", keys()[1::2], encoding="jpeg", urdf=False)
    import_again(folder)
    calibration(folder, "run", codes=(1,))
    with_software(folder, image, 0.0)  # which knows the new answer too


def worse_software(folder: Path, image: str) -> None:
    with_software(folder, image, 0.002)


CHANGES: list[tuple[Callable[[Path, str], None], int, list[str]]] = [
    (
        longer_upper_arm,
        1,
        ["upper_arm_link's link does not fit: ", "beside: the robot's moving transforms: look there"],
    ),
    (other_camera_info, 1, ["rgb_world's focal length does not fit: ", "beside: camera_info of rgb_world: look there"]),
    (worse_software, 1, ["worse than the baseline: distance from our optimum: found 2 mm"]),
    (other_recording, 0, []),
]


@pytest.mark.thorough
def test_from_a_bag_to_pull_requests(caller: Caller, api: GitHub, python_image: str, tmp_path: Path) -> None:
    folder = caller.repository.folder
    shutil.copy(SYSTEM / "robot.urdf", folder)
    record_arm(folder / "poses.bag", "bag", keys()[::2], encoding="jpeg", urdf=False)
    (folder / "import.yml").write_text(json.dumps(IMPORT))
    calibration(folder, "import-data", "--config", "import.yml", "--output", "data/robot")
    calibration(folder, "init", "--dataset", "data/robot", "--suite", "me/suite@v1")
    workflow = folder / ".github" / "workflows" / "calibration.yml"
    workflow.write_text(workflow.read_text() + f"      python: {sys.executable}\n")  # nothing is to be installed
    calibration(folder, "run")
    with_software(folder, python_image, 0.0)
    calibration(folder, "run")
    calibration(folder, "accept")
    shutil.copytree(folder / "output", tmp_path / "output")
    shutil.rmtree(folder / "output")
    commit(folder)
    accepted = git(folder, "rev-parse", "HEAD").strip()

    for change, code, causes in CHANGES:
        git(folder, "reset", "--hard", "--quiet", accepted)
        shutil.copytree(tmp_path / "output", folder / "output")
        change(folder, python_image)
        shutil.rmtree(folder / "output")
        commit(folder)
        run = pull_request(caller, api, accepted, tmp_path)
        assert run.code == code, run.log
        assert "In space" in (caller.artifacts / "calibration" / "report.html").read_text()
        [comment] = api.bodies()
        assert f"Calibration: {'fail' if code else 'pass'}" in comment
        for cause in causes:
            assert cause in comment.replace("\\", ""), comment


def pull_request(caller: Caller, api: GitHub, base: str, tmp_path: Path) -> Run:
    """Act's run of the team's own pull request."""
    event = json.loads(json.dumps(FORK))
    event["pull_request"]["base"]["sha"] = base
    event["pull_request"]["head"]["repo"] = {"full_name": "me/robot"}
    path = tmp_path / "event.json"
    path.write_text(json.dumps(event))
    return caller.run(
        "pull_request", "-e", str(path), "-s", f"GITHUB_TOKEN={TOKEN}", "--env", f"INPUT_API_URL={api.url}"
    )
