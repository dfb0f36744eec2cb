"""The page in a real browser: what a user does with it, from the first look to a collected dataset."""

import json
import re
import signal
from pathlib import Path

import numpy as np
import pytest

from calibration.__main__ import main
from calibration.addons.recorder.scene import extent, view_point
from calibration.addons.recorder.session import Session
from calibration.robot.simulation.motion import motion_document, read_motion
from calibration.robot.simulation.motion_generation import generate_motion
from calibration.robot.simulation.system import System

pytest.importorskip("playwright")
from playwright.sync_api import expect

from tests.addons.recorder.browser import browser, recorder
from tests.addons.recorder.conftest import DATASETS
from tests.chromium import CHROMIUM

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")


def test_record_a_sequence_and_collect_from_it(systems: dict[str, System], tmp_path: Path) -> None:
    system = systems["t2rgb"]
    begun = Session(system)
    three = generate_motion(system, 3, seed=2)
    (tmp_path / "three.json").write_text(json.dumps(motion_document(three)))
    output = tmp_path / "motion.json"
    arguments = ["--system", str(DATASETS / "t2rgb"), "--overwrite"]
    with recorder(tmp_path, *arguments) as running, browser() as view:
        view.open(running.url)
        assert "Kept" in view.settled()
        expect(view.button("Export")).to_be_disabled()

        # Drag the handle along its x axis; the pose and the pictures follow
        T_world_handle = begun.handle_pose()
        assert T_world_handle is not None
        axis, middle = T_world_handle[:3, 0] * extent(system, begun.placement), T_world_handle[:3, 3]
        view.drag_in_scene(middle + 0.2 * axis, middle + 0.3 * axis, *view_point(system, begun.placement))
        view.click("Save pose")
        view.has_poses("1 pose, all kept")

        # Turn the board's back to the cameras: lost, and said
        turn = view.page.get_by_role("textbox").nth(3)
        angle = float(turn.input_value())
        turn.fill(f"{angle + 180:.2f}")
        expect(view.page.locator("#verdict")).to_contain_text("Lost", timeout=60_000)
        turn.fill(f"{angle + 5:.2f}")
        expect(view.page.locator("#verdict")).to_contain_text("Kept", timeout=60_000)
        view.click("Save pose")
        view.has_poses("2 poses, all kept")
        view.click("Export")
        view.says("2 poses written to motion.json")
        saved = read_motion(output)
        assert saved.positions is not None
        assert begun.pose.positions is not None
        way = saved.positions[0] - begun.pose.positions[0]  # the model moves as the handle does, which was not turned
        assert np.linalg.norm(way) > 0.02
        np.testing.assert_allclose(way / np.linalg.norm(way), T_world_handle[:3, 0], atol=0.02)

        # Load another one, add a pose to it; the file is not replaced without a question
        with view.page.expect_file_chooser() as chooser:
            view.click("Load a sequence")
        chooser.value.set_files(tmp_path / "three.json")
        view.has_poses(re.compile("^3 poses"))
        view.click("Save pose")
        view.has_poses(re.compile("^4 poses"))
        view.click("Move earlier")
        view.click("Move earlier")
        expect(view.page.get_by_role("img", name="pose 2,")).to_have_css("outline-width", "3px")
        output.write_text("somebody else's")
        view.click("Export")
        view.says(re.compile("exists already"))
        assert output.read_text() == "somebody else's"
        view.click("Replace motion.json")
        view.says(re.compile("^4 poses written"))
        with view.page.expect_download() as download:
            view.click("Download")
        assert Path(download.value.path()).read_bytes() == output.read_bytes()
        four = read_motion(output)
        assert three.positions is not None
        assert four.positions is not None
        np.testing.assert_array_equal(four.positions, three.positions[[0, 0, 1, 2]])

        # Play, stop, change, and end without an export
        view.click("Play")
        view.click("Stop")
        view.click("Delete pose")
        view.has_poses(re.compile("^3 poses"))
        view.click("Undo")
        view.has_poses(re.compile("^4 poses"))
        view.click("Delete pose")
        view.has_poses(re.compile("^3 poses"))
        view.page.screenshot(path=tmp_path / "page.png")
        assert view.foreign_requests == []
        assert view.requests
        assert running.stop(signal.SIGTERM) == 143
    assert "Traceback" not in running.output
    assert "3 poses not exported, now in motion.autosave.json" in running.output
    assert len(read_motion(tmp_path / "motion.autosave.json")) == 3

    arguments = ["--system", str(DATASETS / "t2rgb"), "--motion", str(output), "--output", str(tmp_path / "dataset")]
    main(["collect-data-sim", *arguments])
    assert len(json.loads((tmp_path / "dataset" / "dataset.json").read_bytes())["collections"]) == 4


@pytest.mark.thorough
def test_an_arm_is_moved_by_its_joints_and_by_its_handle(systems: dict[str, System], tmp_path: Path) -> None:
    system = systems["riwbot"]
    begun = Session(system)
    with recorder(tmp_path, "--system", str(DATASETS / "riwbot")) as running, browser() as view:
        view.open(running.url)
        slider = view.page.get_by_role("slider").nth(len(system.robot.movable) - 1)
        slider.press("ArrowRight")  # the last joint, by a tenth of a degree
        view.settled()
        view.click("Save pose")
        view.has_poses("1 pose, all kept")
        T = begun.handle_pose()
        assert T is not None
        axis, middle = T[:3, 0] * extent(system, begun.placement), T[:3, 3]
        view.drag_in_scene(middle + 0.2 * axis, middle + 0.25 * axis, *view_point(system, begun.placement))
        view.click("Save pose")
        view.has_poses(re.compile("^2 poses"))
        view.click("Export")
        view.says(re.compile("^2 poses written"))
        assert view.foreign_requests == []
        assert running.stop(signal.SIGINT) == 130
    assert "Traceback" not in running.output
    assert "autosave" not in running.output
    motion = read_motion(tmp_path / "motion.json")
    last = list(system.robot.movable)[-1]
    assert abs(motion.joints[last][0] - begun.pose.joints[last][0]) == pytest.approx(
        np.radians(0.1), abs=np.radians(0.06)
    )
    first, second = (Session(system, motion.take([i])).handle_pose() for i in range(2))
    assert first is not None
    assert second is not None
    way = second[:3, 3] - first[:3, 3]
    assert np.linalg.norm(way) > 0.005
    np.testing.assert_allclose(way / np.linalg.norm(way), T[:3, 0], atol=0.02)
