"""Tasks at joint positions of one's own: the same as at the recording's where these are, else refused in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

from calibration.__main__ import main
from calibration.base import InputError
from calibration.base.arrays import Array
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.fixed_inputs import LAG_KIND, PLACE_KIND
from calibration.engine.tasks.robot_task import RobotTask
from calibration.engine.tasks.task_errors import TaskError, task_errors
from calibration.pipeline.matrix.loaded_system import load
from calibration.pipeline.system import System

DATASETS = Path(__file__).parents[3] / "datasets"
OF_ARM = {"of": "flange", "frame": "world", "points": ((0.0, 0.0, 0.1),)}
OF_SLIDE = {"seen_by": ("rgb_hand",), "frame": "base_link", "distance": 0.6}


def recorded_joints(system: str) -> list[dict[str, float]]:
    motion = json.loads((DATASETS / system / "motion.json").read_text())
    return [motion[key]["joints"] for key in sorted(motion, key=int)]


def errors_at(system: str, *tasks: RobotTask) -> list[TaskError]:
    loaded = load(System(system, DATASETS / system, tasks=tasks))
    return task_errors(calibrate(loaded.dataset), loaded.tasks)


@pytest.mark.parametrize(("system", "task"), [("riwbot", OF_ARM), ("spjbot", OF_SLIDE)])
def test_at_the_joints_of_the_recording_they_are_those_of_its_poses(system: str, task: dict[str, object]) -> None:
    """Derivatives by all that is calibrated, held or suspected; but by an order of the poses."""
    recorded = recorded_joints(system)
    poses = (2, 7, 4)
    joints = {name: tuple(recorded[pose][name] for pose in poses) for name in recorded[0]}
    keys = tuple(f"{pose:03d}" for pose in poses)
    its, own = errors_at(
        system,
        RobotTask("its", collections=keys, **task),  # type: ignore[arg-type]
        RobotTask("own", joints=joints, **task),  # type: ignore[arg-type]
    )
    np.testing.assert_allclose(own.placed.places, its.placed.places, atol=1e-5)
    np.testing.assert_allclose(own.most, its.most, rtol=1e-4)
    model = calibrate(load(System(system, DATASETS / system)).dataset).solution.model
    by_order = [at for cause, at in model.placed() if cause.kind in ("backlash", LAG_KIND, PLACE_KIND)]

    def without_order(found: Array) -> Array:
        return np.delete(found, np.concatenate([np.arange(at.start, at.stop) for at in by_order]), axis=-1)

    scale = np.abs(without_order(its.jacobian)).max()
    np.testing.assert_allclose(without_order(own.jacobian), without_order(its.jacobian), atol=1e-4 * scale)


def test_elsewhere_an_arm_that_reaches_farther_errs_more() -> None:
    """Stretched out, against folded: poses that no collection has."""
    still = dict.fromkeys(("shoulder_pan_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"), (0.0,))
    stretched, folded = (
        RobotTask(name, joints={**still, "shoulder_lift_joint": (-0.3,), "elbow_joint": (at,)}, **OF_ARM)  # type: ignore[arg-type]
        for name, at in (("stretched", 0.0), ("folded", 2.8))
    )
    far, near = errors_at("riwbot", stretched, folded)
    assert far.parts()["arm"] > 1.2 * near.parts()["arm"]


BAD: dict[str, tuple[dict[str, tuple[float, ...]], dict[str, object], str]] = {
    "unknown": ({"elbow": (0.0,)}, OF_ARM, "elbow"),
    "beyond its limits": ({"elbow_joint": (0.1, 4.0)}, OF_ARM, "elbow_joint.*pose 2.*3.14"),
    "others move too": ({"elbow_joint": (0.1,)}, OF_ARM, "a position of shoulder_pan_joint"),
    "not between": (
        {"elbow_joint": (0.1,)},
        {"seen_by": ("rgb_world",), "frame": "base_link", "distance": 1.0},
        "no joint between",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_joints_that_do_not_fit_are_named(case: str) -> None:
    """Before anything is calibrated."""
    joints, task, said = BAD[case]
    with pytest.raises(InputError, match=rf"^systems\.riwbot\.tasks\.work\.joints: .*{said}"):
        load(System("riwbot", DATASETS / "riwbot", tasks=(RobotTask("work", joints=joints, **task),)))  # type: ignore[arg-type]


def test_without_a_description_it_is_wrong_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2, one line; and where the description is named, it is read."""
    folder = tmp_path / "arm"
    folder.mkdir()
    (folder / "dataset.json").write_bytes((DATASETS / "riwbot" / "dataset.json").read_bytes())
    for image in (DATASETS / "riwbot").glob("*.jpg"):
        (folder / image.name).symlink_to(image)
    pose = {name: [0.1] for name in recorded_joints("riwbot")[0]}
    tip = {"of": "flange", "in": "world", "points": [[0, 0, 0]], "joints": pose}
    system = {"dataset": "arm", "tasks": {"tip": tip}}
    path = tmp_path / "calibration.yml"
    path.write_text(json.dumps({"systems": {"arm": system}}))
    command = ["calibrate-matrix", "--config", str(path), "--output", str(tmp_path / "output"), "--jobs", "1"]
    assert main(command) == 2
    said = capsys.readouterr()
    assert "systems.arm.tasks.tip.joints: found no description" in said.err + said.out
    exports = {"robot-description": str(DATASETS / "riwbot" / "robot.urdf")}
    path.write_text(json.dumps({"systems": {"arm": {**system, "exports": exports}}}))
    assert main(command) == 0
    [cell] = json.loads((tmp_path / "output" / "results.json").read_text())["cells"]
    assert cell["tasks"][0]["worst"].endswith("in pose 1 of its joints")
