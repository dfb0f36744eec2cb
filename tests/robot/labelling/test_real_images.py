"""Real images of the paper's dataset: our labels against those that ATOM made, and what they calibrate to."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.evaluation.two_sensors import rgb_to_rgb
from calibration.engine.geometry.transforms import distance
from calibration.robot.labelling.corner_detector import corner_detector
from calibration.robot.labelling.detection import NotDetected

PATTERN = PatternConfiguration(
    "pattern_1", "charuco", "pattern_link", "world", False, (11, 8), 0.06, 0.045, (0.04, 0.03), "DICT_5X5_100"
)
Labels = Mapping[tuple[int, str], CornerLabels]


@cache
def labelled(folder: Path) -> tuple[Dataset, Labels, Labels, list[str]]:
    """The dataset, ATOM's labels, ours, and the reasons where we have none."""
    dataset = read_dataset(folder)
    detector, ours, theirs, reasons = corner_detector(PATTERN), {}, {}, []
    for i, collection in enumerate(dataset.collections):
        for camera in dataset.sensors:
            found = detector.detect(cv2.imread(str(folder / f"{camera}_{collection.key}.jpg")))
            if isinstance(found, NotDetected):
                reasons.append(found.reason)
            else:
                ours[i, camera] = found
            if ((name := next(iter(dataset.patterns))), camera) in collection.labels:
                theirs[i, camera] = collection.labels[name, camera]
    return dataset, theirs, ours, reasons


def with_labels(dataset: Dataset, labels: Labels) -> Dataset:
    (pattern,) = dataset.patterns
    collections = [
        replace(c, labels={(pattern, s): labels[i, s] for s in dataset.sensors if (i, s) in labels})
        for i, c in enumerate(dataset.collections)
    ]
    return replace(dataset, collections=tuple(collections))


def test_all_views_of_atom_and_more(shared_data: Path) -> None:
    _, theirs, ours, reasons = labelled(shared_data / "t2rgb-paper")
    assert len(theirs) == 34
    assert set(theirs) <= set(ours)
    assert len(ours) == 39
    assert len(reasons) == 5
    assert all("needed" in reason for reason in reasons)


def test_the_ids_are_those_of_atom_and_the_corners_half_a_pixel_away(shared_data: Path) -> None:
    """OpenCV 4.6 called the corner of the top-left pixel (0, 0); what else differs are its coarse labels."""
    _, theirs, ours, _ = labelled(shared_data / "t2rgb-paper")
    differences, missing, total = [], 0, 0
    for view, label in theirs.items():
        _, a, b = np.intersect1d(label.ids, ours[view].ids, return_indices=True)
        differences.append(ours[view].pixels[b] - label.pixels[a])
        missing, total = missing + len(label.ids) - len(a), total + len(label.ids)
    difference = np.concatenate(differences)
    assert missing <= 0.01 * total
    np.testing.assert_allclose(np.median(difference, axis=0), [-0.5, -0.5], atol=0.06)
    apart = np.linalg.norm(difference + 0.5, axis=-1)
    assert np.median(apart) < 0.2
    assert np.percentile(apart, 95) < 1.3
    assert apart.max() < 8  # a square is 15 to 40 pixels: a wrong id would be more


@pytest.mark.parametrize("loss", ["linear", "huber"])
@pytest.mark.parametrize("only_theirs", [False, True])
def test_they_calibrate_better_than_those_of_atom(shared_data: Path, loss, only_theirs) -> None:
    dataset, theirs, ours, _ = labelled(shared_data / "t2rgb-paper")
    chosen = {view: label for view, label in ours.items() if view in theirs} if only_theirs else ours
    cameras = ("right_camera", "left_camera")
    frames = [dataset.sensors[name].frame for name in cameras]

    def calibrated(labels: Labels) -> tuple[float, float]:
        """RMS of the evaluation (px), and the distance from the simulated truth (m)."""
        result = calibrate(with_labels(dataset, labels), Options(loss=loss))
        assert result.converged
        off, _ = distance(dataset.transform(*frames)[0], result.dataset.transform(*frames)[0])
        return float(rgb_to_rgb(result.dataset, *cameras).averages[0]), float(off)

    rms, off = calibrated(chosen)
    their_rms, their_off = calibrated(theirs)
    assert their_rms == pytest.approx(0.600, abs=0.001)
    assert rms < 0.26
    assert off < their_off
