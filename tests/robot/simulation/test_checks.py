"""Reasons for rejecting a collection."""

from dataclasses import replace

import numpy as np

from calibration.engine.dataset.model import CornerLabels
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.simulation.capture import Capture, Requirements, capture, image_share, reasons_to_lose
from calibration.robot.simulation.kinematics import Play, play
from calibration.robot.simulation.system import System
from tests.robot.simulation.conftest import own_motion

KEY = ("pattern_1", "left_camera")


def seen(systems: dict[str, System], sway: float = 0.0) -> tuple[System, Capture]:
    system = replace(systems["t2rgb"], sway=sway)
    return system, capture(play(system, own_motion(system).take([0]), 1), 0)


def test_nothing_speaks_against_a_good_one(systems: dict[str, System]) -> None:
    assert reasons_to_lose(*seen(systems), Requirements()) == ()


def test_every_sensor_has_to_detect(rlbot_play: Play, systems: dict[str, System]) -> None:
    reasons = reasons_to_lose(rlbot_play.system, capture(rlbot_play, 1), Requirements())
    assert [reason.partition(":")[0] for reason in reasons] == ["lidar_right", "rgb_left"]
    system, found = seen(systems)
    blind = replace(found, labels={**found.labels, KEY: NotDetected("3 markers")})
    assert reasons_to_lose(system, blind, Requirements()) == ("left_camera: 3 markers",)


def test_one_pattern_of_several_is_enough(systems: dict[str, System]) -> None:
    system, found = seen(systems)
    second = {("pattern_2", name): NotDetected("hidden") for name in system.cameras}
    assert reasons_to_lose(system, replace(found, labels={**found.labels, **second}), Requirements()) == ()
    nothing = {("pattern_1", name): NotDetected("too far") for name in system.cameras}
    reasons = reasons_to_lose(system, replace(found, labels={**nothing, **second}), Requirements())
    assert reasons[0] == "left_camera: pattern_1: too far; pattern_2: hidden"


def test_what_moves_is_lost(systems: dict[str, System]) -> None:
    system, found = seen(systems, sway=0.01)
    (reason,) = reasons_to_lose(system, found, Requirements(stillness=0.002))
    assert reason == f"moved {1000 * found.movement:.1f} mm while the sensors looked, 2 mm are allowed"
    assert reasons_to_lose(system, found, Requirements(stillness=1.01 * found.movement)) == ()
    assert len(reasons_to_lose(system, found, Requirements(stillness=0.99 * found.movement))) == 1


def test_what_is_too_small_is_lost(systems: dict[str, System]) -> None:
    system, found = seen(systems)
    labels = found.labels[KEY]
    assert isinstance(labels, CornerLabels)
    share = image_share(system.cameras["left_camera"].camera, labels)
    shrunk = CornerLabels(labels.ids, labels.pixels.mean(0) + 0.1 * (labels.pixels - labels.pixels.mean(0)))
    assert np.isclose(image_share(system.cameras["left_camera"].camera, shrunk), share / 100)
    (reason,) = reasons_to_lose(system, replace(found, labels={**found.labels, KEY: shrunk}), Requirements())
    assert reason.startswith("left_camera: the corners span 0.")
    assert reason.endswith("% of the image, 0.5 % are needed")
