"""The scene of a robot: what is where, in which collection."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.engine.dataset.model import Dataset, PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.geometry.transforms import apply, transform, translation
from calibration.pipeline.page.in_space import KINDS, MAX_BOARDS, MAX_CLOUD_POINTS, in_space
from calibration.pipeline.page.label_residuals import residuals_by_sensor

DATASETS = Path(__file__).parents[2] / "datasets"


@pytest.fixture(scope="module")
def rlbot() -> Dataset:
    return read_dataset(DATASETS / "rlbot")


@pytest.fixture(scope="module")
def with_boards(rlbot: Dataset) -> Dataset:
    """The dataset with patterns in the planes of the LiDAR's points."""
    [pattern] = rlbot.patterns.values()
    T_world_lidar = rlbot.transform(rlbot.world, rlbot.sensors["lidar_right"].frame)
    T_world_pattern = np.full((len(rlbot.collections), 4, 4), np.nan)
    for i, labels in rlbot.detections(pattern.name, "lidar_right"):
        assert isinstance(labels, PointLabels)
        seen = apply(T_world_lidar[i], labels.points)
        axes = np.linalg.svd(seen - seen.mean(axis=0), full_matrices=False)[2].T
        T_world_pattern[i] = transform(axes * np.linalg.det(axes), seen.mean(axis=0))
    return replace(rlbot, transforms={**rlbot.transforms, (rlbot.world, pattern.link): T_world_pattern})


def drawn(html: str) -> dict[str, list[dict[str, object]]]:
    found = re.search(r'<script type="application/json">(.*?)</script>', html)
    assert found
    scene: dict[str, list[dict[str, object]]] = json.loads(found[1])
    return scene


def points(entry: dict[str, object]) -> np.ndarray:
    return np.array(entry["p"]).reshape(-1, 3)


def test_points_of_a_lidar_lie_on_the_pattern_of_their_collection(with_boards: Dataset) -> None:
    scene = drawn(in_space(with_boards, None, None, residuals_by_sensor(with_boards)))
    boards = {line["k"]: points(line) for line in scene["lines"] if line["c"] == "pattern"}
    clouds = {cloud["k"]: cloud for cloud in scene["clouds"]}
    assert clouds.keys() == boards.keys()
    assert len(scene["collections"]) == len(boards) <= MAX_BOARDS
    assert 0.9 * MAX_CLOUD_POINTS < sum(len(points(cloud)) for cloud in clouds.values()) <= MAX_CLOUD_POINTS
    for number, cloud in clouds.items():
        corner, across, _, down, _ = boards[number]
        normal = np.cross(across - corner, down - corner)
        off = (points(cloud) - corner) @ (normal / np.linalg.norm(normal))
        assert np.abs(off).max() < 0.1
        values = np.array(cloud["v"])
        assert 0 <= values.min() <= values.max() <= 1
        assert np.corrcoef(np.minimum(np.abs(off), 0.03), values)[0, 1] > 0.5  # red is what is far


def test_the_accepted_place_of_a_sensor_is_beside_the_one_now(rlbot: Dataset) -> None:
    edge = rlbot.sensors["lidar_right"].edge
    accepted = rlbot.with_transforms({edge: rlbot.transforms[edge] @ translation((0.1, 0.0, 0.0))})
    lines = drawn(in_space(rlbot, None, accepted))["lines"]
    assert {line["c"] for line in lines} <= KINDS.keys()
    now, before = ([points(line).mean(axis=0) for line in lines if line["c"] == kind] for kind in ("range", "accepted"))
    assert min(np.linalg.norm(now[0] - each) for each in before) == pytest.approx(0.1, abs=1e-3)


def test_what_moves_with_an_arm_is_drawn_in_each_collection_and_once_in_all() -> None:
    dataset = read_dataset(DATASETS / "spjbot")
    sensors = [line for line in drawn(in_space(dataset, None))["lines"] if line["c"] == "camera"]
    assert [line["k"] for line in sensors] == list(range(len(dataset.collections)))
    assert [line["a"] for line in sensors] == [True] + [False] * (len(sensors) - 1)
    assert not np.allclose(points(sensors[0]), points(sensors[1]))
