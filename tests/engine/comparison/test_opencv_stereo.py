"""OpenCV's stereo calibration on datasets."""

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InfrastructureError, InputError, UndeterminedError
from calibration.engine.comparison import COMPARISON_METHODS
from calibration.engine.comparison.sensor_pairs import opencv_stereo, why_not_stereo
from calibration.engine.dataset.modalities import DEPTH
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.evaluation.two_sensors import rgb_to_rgb
from calibration.engine.geometry.lenses import Equidistant, Rational
from calibration.engine.geometry.transforms import distance, from_xyz_rpy, retract
from tests.engine.evaluation.scene import WIDE, arm, cut, lidar, two_cameras

cv2 = pytest.importorskip("cv2")

DATASETS = Path(__file__).resolve().parents[3] / "datasets"
RIGHT, LEFT = ("right_mount", "right_link"), ("left_mount", "left_link")


def disturbed(dataset: Dataset, edge: tuple[str, str]) -> Dataset:
    twist = np.broadcast_to([0.3, -0.2, 0.4, 0.5, -0.5, 0.3], (len(dataset.keys), 6))
    return dataset.with_transforms({edge: retract(dataset.transforms[edge], twist)})


def relative_error(a: Dataset, b: Dataset, first: str, second: str) -> tuple[float, float]:
    """mm and deg, worst seen from either camera."""
    poses = [[d.transform(*f)[0] for d in (a, b)] for f in ((first, second), (second, first))]
    errors = [distance(*pair) for pair in poses]
    return max(1000 * float(t) for t, _ in errors), max(float(np.degrees(r)) for _, r in errors)


def test_exact_views_give_the_exact_second_camera():
    dataset, _ = two_cameras(seed=1, n=12, right=WIDE)
    found = opencv_stereo(disturbed(dataset, RIGHT), fixed=True)
    np.testing.assert_allclose(found.transforms[RIGHT], dataset.transforms[RIGHT], atol=1e-5)
    assert found.transforms[LEFT] is dataset.transforms[LEFT]


def test_with_intrinsics_estimated_again_exact_views_still_do():
    dataset, _ = two_cameras(seed=2, n=12)
    millimetres, degrees = relative_error(
        dataset, opencv_stereo(disturbed(dataset, RIGHT)), "left_optical", "right_optical"
    )
    assert millimetres < 0.1
    assert degrees < 0.02


def test_a_lens_with_a_fraction_of_polynomials():
    bent = replace(WIDE, distortion=Rational(-0.2, 0.05, 1e-3, -5e-4, 0.0, 0.05, 0.02, 0.0))
    dataset, _ = two_cameras(seed=1, n=12, right=bent)
    found = opencv_stereo(disturbed(dataset, RIGHT), fixed=True)
    np.testing.assert_allclose(found.transforms[RIGHT], dataset.transforms[RIGHT], atol=1e-5)
    millimetres, _ = relative_error(dataset, opencv_stereo(disturbed(dataset, RIGHT)), "left_optical", "right_optical")
    assert millimetres < 0.1


def test_a_fisheye_lens_is_none_of_its():
    dataset, _ = two_cameras(seed=1, n=12, right=replace(WIDE, distortion=Equidistant()))
    assert why_not_stereo(dataset) == "it knows no lens equidistant as that of 'right'"
    with pytest.raises(InputError, match="does not apply: it knows no lens equidistant"):
        opencv_stereo(dataset)


def test_an_anchored_camera_stays():
    dataset, _ = two_cameras(seed=3, n=12)
    anchored = replace(disturbed(dataset, LEFT), anchored="right")
    found = opencv_stereo(anchored, fixed=True)
    assert found.transforms[RIGHT] is dataset.transforms[RIGHT]
    np.testing.assert_allclose(found.transforms[LEFT], dataset.transforms[LEFT], atol=1e-5)


def test_the_synthetic_rig_gives_the_known_figures(shared_data):
    dataset = read_dataset(shared_data / "synthetic" / "t2rgb")
    frames = tuple(dataset.sensors[s].frame for s in ("left_camera", "right_camera"))
    millimetres, degrees = relative_error(dataset, opencv_stereo(dataset), *frames)
    if cv2.__version__.startswith("5"):
        assert millimetres == pytest.approx(5.05, abs=0.02)
        assert degrees == pytest.approx(0.265, abs=0.001)
    assert 3 < millimetres < 6  # OpenCV 4 stops a little earlier on the same slope
    assert 0.1 < degrees < 0.3
    millimetres, degrees = relative_error(dataset, opencv_stereo(dataset, fixed=True), *frames)
    assert millimetres < 1
    assert degrees < 0.02


@pytest.mark.thorough
def test_opencv_4_with_more_steps_ends_where_opencv_5_does(monkeypatch):
    """So that they differ is no wrong use of either: the one that stops early has the larger reprojection error."""
    dataset = read_dataset(DATASETS / "t2rgb")
    calibrate, found = cv2.stereoCalibrate, []

    def row(**criteria):
        def asked(*arguments, **options):
            answer = calibrate(*arguments, **{**options, **criteria})
            found.append(answer[0])
            return answer

        monkeypatch.setattr(cv2, "stereoCalibrate", asked)
        return rgb_to_rgb(opencv_stereo(dataset), "right_camera", "left_camera").average("RMS (pix)")

    early, late = row(), row(criteria=(cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 1000, 1e-9))
    assert late == pytest.approx(0.288, abs=0.003)
    assert found[1] == pytest.approx(0.085683, abs=2e-6)
    if cv2.__version__.startswith("4"):
        assert early == pytest.approx(0.097, abs=0.001)
        assert found[0] > found[1] + 5e-4
    else:
        assert early == pytest.approx(late)


def test_without_complete_detections_the_common_corners_count(shared_data):
    dataset = read_dataset(shared_data / "t2rgb-paper")  # no collection is complete in both cameras
    free, fixed = (
        rgb_to_rgb(method(dataset), "right_camera", "left_camera").average("RMS (pix)")
        for method in (opencv_stereo, partial(opencv_stereo, fixed=True))
    )
    assert fixed == pytest.approx(0.6002, abs=5e-4)
    assert free > 3 * fixed  # as in the paper: its intrinsics are not those of the table


def test_partial_views_are_left_out_where_there_are_enough_complete_ones():
    dataset, _ = two_cameras(seed=4, n=8, noise=0.3)
    partial = cut(dataset, "left", [30, 30, 30, 30, 20, 20, 20, 20])
    whole = dataset.with_collections([0, 1, 2, 3])
    np.testing.assert_array_equal(
        opencv_stereo(partial, fixed=True).transforms[RIGHT][0], opencv_stereo(whole, fixed=True).transforms[RIGHT][0]
    )


def test_why_it_does_not_apply():
    dataset, _ = two_cameras(seed=5, n=4)
    assert why_not_stereo(dataset) is None
    swaying = np.stack([from_xyz_rpy([0, 0.15, 0], [0, 0, yaw]) for yaw in (0, 0.1, 0.2, 0.3)])
    for other, reason in (
        (arm(n=3), r"it needs two cameras, and there are 'eye' \(rgb\)"),
        (
            replace(dataset, sensors={"left": dataset.sensors["left"], "scan": lidar("scan")}),
            r"it needs two cameras, and there are 'left' \(rgb\), 'scan' \(lidar3d\)",
        ),
        (
            replace(dataset, sensors={**dataset.sensors, "right": replace(dataset.sensors["right"], modality=DEPTH)}),
            r"it needs two cameras, and there are .*'right' \(depth\)",
        ),
        (
            replace(dataset, additional_transforms=(("a", "b"),)),
            "it cannot calibrate additional transforms, such as 'a-b'",
        ),
        (
            dataset.with_transforms({("world", "left_mount"): swaying}),
            "it needs sensors that keep their places, and 'right' moves against 'left'",
        ),
        (
            cut(dataset, "left", [30, 30, 5, 5]),
            "it needs 3 views of 6 corners seen by both cameras, and there are 2",
        ),
    ):
        with pytest.raises(InputError, match=f"dataset.json: OpenCV's stereo calibration does not apply: {reason}$"):
            opencv_stereo(other)


def test_other_sensors_stay_where_they_are():
    dataset, _ = two_cameras(seed=6, n=12)
    with_scan = replace(dataset, sensors={"scan": lidar("scan"), **dataset.sensors}, anchored="scan")
    with_scan = with_scan.with_transforms({("scan_mount", "scan_base"): np.eye(4)})
    found = opencv_stereo(disturbed(with_scan, RIGHT), fixed=True)
    np.testing.assert_allclose(found.transforms[RIGHT], dataset.transforms[RIGHT], atol=1e-5)
    part = COMPARISON_METHODS["opencv-stereo"].part(found)
    assert (list(part.sensors), part.anchored) == (["left", "right"], None)
    assert COMPARISON_METHODS["opencv-stereo"].part(replace(found, anchored="left")).anchored == "left"
    assert COMPARISON_METHODS["opencv-stereo"].describe(found) == f"OpenCV {cv2.__version__}"


def test_what_opencv_refuses_is_told_in_one_line(monkeypatch):
    def refuse(*_args, **_kwargs):
        raise cv2.error("Assertion failed\n > in function 'x'")

    monkeypatch.setattr(cv2, "stereoCalibrate", refuse)
    with pytest.raises(UndeterminedError, match="OpenCV's stereo calibration: Assertion failed > in function 'x'"):
        opencv_stereo(two_cameras(n=4)[0])


def test_an_answer_that_is_no_number_is_an_error(monkeypatch):
    monkeypatch.setattr(cv2, "stereoCalibrate", lambda *_a, **_k: (0, 0, 0, 0, 0, np.eye(3), np.full((3, 1), np.nan)))
    with pytest.raises(UndeterminedError, match="finds no finite pose"):
        opencv_stereo(two_cameras(n=4)[0])


def test_without_opencv_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(InfrastructureError, match=r"needs OpenCV: pip install opencv-python-headless"):
        opencv_stereo(two_cameras(n=4)[0])
