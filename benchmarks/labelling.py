"""Labels from images and clouds against the truth and against OpenCV's own detector: how near, how many, how fast."""

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import FOLDER, ROOT, load, missing
from benchmarks.timing import seconds
from calibration.base.arrays import Array
from calibration.engine.dataset.modalities import LIDAR3D
from calibration.engine.dataset.model import CornerLabels, Dataset, PointLabels
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.sensor_data import read_points
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.evaluation.truth import read_truth
from calibration.engine.evaluation.two_sensors import rgb_to_rgb
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import distance, inverse, transform, translation
from calibration.robot.importing.arrivals import Arrival, Arrivals
from calibration.robot.importing.look.judging import ImageJudge
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.marked_boards import CharucoDetector
from calibration.robot.labelling.points import label_points
from calibration.robot.labelling.unmarked_grids import ChessboardDetector
from tests.robot.labelling.pictures import (
    HD,
    HD_DISTORTED,
    VGA,
    Photograph,
    charuco,
    chessboard,
    facing,
    in_view,
    true_corners,
)

BOARD, CHESSBOARD = charuco(), chessboard()
Corners = tuple[Array, Array]
"""Ids and pixels."""
PAPER = "t2rgb-paper"
WATCHED_FILES = 5000
"""Images in a folder that is polled."""
CAMERAS = ("right_camera", "left_camera")


def measure(quick: bool) -> Iterator[Row]:
    """Synthetic views, the paper's images, and the clouds of a shipped dataset."""
    count = 4 if quick else 24
    yield from _synthetic("720p", HD, count, Bar(high=0.06))
    yield from _synthetic("720p distorted", HD_DISTORTED, count, Bar(high=0.08))
    yield from _synthetic("480p", VGA, count, Bar(high=0.12))
    yield from _chessboards(count)
    yield from _watched_folder()
    if reason := missing(PAPER):
        yield Row("labelling/paper", skipped=reason)
    else:
        yield from _paper()
    yield from _clouds(2 if quick else 10)


def _synthetic(name: str, camera: object, count: int, bar: Bar) -> Iterator[Row]:
    """Charuco boards at 1 to 2 m, tilted up to 40 degrees, blurred and noisy; OpenCV's detector on the same images."""
    views = _views(camera, BOARD, count)
    ours, took = _errors(views, _ours)
    theirs, their_time = _errors(views, _opencv)
    rms, their_rms = (float(np.sqrt((e**2).sum(-1).mean())) for e in (ours, theirs))
    note = f"OpenCV's own detector {their_rms:.4f}; the worst corner {np.linalg.norm(ours, axis=-1).max():.2f}"
    yield Row(f"labelling/{name}, RMS", rms, "px", bar, note)
    yield Row(f"labelling/{name}, bias", float(np.abs(ours.mean(axis=0)).max()), "px", Bar(high=0.01))
    seen = sum(int(in_view(camera, truth).sum()) for _, truth in views)
    note = f"OpenCV's own {100 * len(theirs) / seen:.1f}"
    yield Row(f"labelling/{name}, found", 100 * len(ours) / seen, "%", Bar(low=97), note)
    yield Row(f"labelling/{name}, time", took, "ms", note=f"OpenCV's own {their_time:.1f} ms")


def _views(camera: object, pattern: object, count: int) -> list[tuple[Array, Array]]:
    random, photograph, views = np.random.default_rng(5), Photograph(camera, supersampling=2), []
    for _ in range(count):
        turns = random.uniform([0, -3, -3], [0.7, 3, 3])
        T = facing(pattern, random.uniform(1, 2), *turns, tuple(random.uniform(-0.2, 0.2, 2) * [0.8, 0.5]))
        views.append((photograph.of(pattern, T), true_corners(camera, pattern, T)))
    return views


def _errors(views: list[tuple[Array, Array]], detect: Callable[[Array], Corners | None]) -> tuple[Array, float]:
    """Detected less projected corners (K, 2), and the median milliseconds of an image."""
    errors, times = [np.zeros((0, 2))], []
    for image, truth in views:
        found: list[Corners | None] = []
        times.append(seconds(lambda image=image, found=found: found.append(detect(image))))
        if found[0] is not None:
            ids, pixels = found[0]
            errors.append(pixels - truth[ids])
    return np.concatenate(errors), 1e3 * statistics.median(times)


_DETECTOR, _CHESSBOARD_DETECTOR = CharucoDetector(BOARD), ChessboardDetector(CHESSBOARD)


def _ours(image: Array) -> Corners | None:
    found = _DETECTOR.detect(image)
    return None if isinstance(found, NotDetected) else (found.ids, found.pixels)


def _our_chessboard(image: Array) -> Corners | None:
    found = _CHESSBOARD_DETECTOR.detect(image)
    return None if isinstance(found, NotDetected) else (found.ids, found.pixels)


def _opencv(image: Array) -> Corners | None:
    board = cv2.aruco.CharucoBoard((12, 9), 1.0, 0.75, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    pixels, ids, _, _ = cv2.aruco.CharucoDetector(board, cv2.aruco.CharucoParameters(), parameters).detectBoard(image)
    return None if ids is None or not len(ids) else (ids.ravel(), pixels.reshape(-1, 2))


def _watched_folder() -> Iterator[Row]:
    """CPU time from an image file to what `watch` says of it, and of a poll of a folder with many that are known."""
    with TemporaryDirectory() as folder:
        for n in range(WATCHED_FILES):
            (Path(folder) / f"known{n}.png").write_bytes(b"1")
        arrivals = Arrivals({"camera": folder})
        arrivals.poll()
        arrivals.poll()
        start = time.process_time()
        arrivals.poll()
        yield Row("labelling/watch poll", 1e3 * (time.process_time() - start), "ms", None, f"of {WATCHED_FILES} files")
    with TemporaryDirectory() as folder:
        judge, times = ImageJudge({BOARD.name: BOARD}, ("camera",)), []
        for n, (image, _) in enumerate(_views(HD, BOARD, 6)):
            path = Path(folder) / f"{n}.png"
            cv2.imwrite(str(path), image)
            start = time.process_time()
            judge.judge(Arrival("camera", path, (1, 1)))
            times.append(time.process_time() - start)
    used = f"{judge.counts['']} of {len(times)} used"
    yield Row("labelling/watch 1280x720", max(times), "s", Bar(high=0.3), f"CPU time, {used}; the poll waits 0.1 s")


def _chessboards(count: int) -> Iterator[Row]:
    whole = [view for view in _views(HD, CHESSBOARD, count) if in_view(HD, view[1]).all()]
    errors, took = _errors(whole, _our_chessboard)
    yield Row("labelling/chessboard, RMS", float(np.sqrt((errors**2).sum(-1).mean())), "px", Bar(high=0.06))
    yield Row("labelling/chessboard, found", 100 * len(errors) / (70 * len(whole)), "%", Bar(low=97))
    yield Row("labelling/chessboard, time", took, "ms")


def _paper() -> Iterator[Row]:
    """The paper's 44 images against the labels in its JSON, and calibrated from ours."""
    dataset = load(PAPER)
    (pattern,) = dataset.patterns
    collections, apart, times, common, theirs, ours, views = [], [], [], 0, 0, 0, 0
    for collection in dataset.collections:
        labels = {}
        for camera in CAMERAS:
            image = cv2.imread(str(FOLDER / PAPER / f"{camera}_{collection.key}.jpg"))
            found: list[CornerLabels | NotDetected] = []
            times.append(seconds(lambda image=image, found=found: found.append(_DETECTOR.detect(image))))
            label, known = found[0], collection.labels.get((pattern, camera))
            theirs += len(known.ids) if isinstance(known, CornerLabels) else 0
            if isinstance(label, CornerLabels):
                labels[pattern, camera] = label
                ours, views = ours + len(label.ids), views + 1
                if isinstance(known, CornerLabels):
                    _, a, b = np.intersect1d(label.ids, known.ids, return_indices=True)
                    apart.append(label.pixels[a] - known.pixels[b])
                    common += len(a)
        collections.append(replace(collection, labels=labels))
    shift = np.median(np.concatenate(apart), axis=0)
    difference = np.linalg.norm(np.concatenate(apart) - shift, axis=-1)
    note = f"95 %: {np.percentile(difference, 95):.2f}, most {difference.max():.2f}, all shifted by {shift.round(2)} px"
    yield Row("labelling/paper, apart", float(np.median(difference)), "px", Bar(high=0.2), note)
    note = f"of ATOM's; {ours} corners in {views} of 44 images, ATOM {theirs} in 34"
    yield Row("labelling/paper, missed", 100 * (theirs - common) / theirs, "%", Bar(high=1), note)
    yield Row("labelling/paper, time", 1e3 * statistics.median(times), "ms", note=f"most {1e3 * max(times):.0f} ms")
    for loss in ("linear", "huber"):
        result = calibrate(replace(dataset, collections=tuple(collections)), Options(loss=loss))
        rms = float(rgb_to_rgb(result.dataset, *CAMERAS).averages[0])
        frames = [dataset.sensors[camera].frame for camera in CAMERAS]
        off, turned = distance(dataset.transform(*frames)[0], result.dataset.transform(*frames)[0])
        note = f"ATOM's labels 0.600; {1e3 * off:.2f} mm, {np.degrees(turned):.4f} deg from the truth (0.42, 0.0275)"
        yield Row(f"labelling/paper, RMS {loss}", rms, "px", Bar(high=0.6), note)


def _clouds(seeds: int) -> Iterator[Row]:
    """The clouds of rlbot from guesses that are 5 cm and 3 degrees off, each its own; as good as the truth's labels?"""
    folder = ROOT / "datasets" / "rlbot"
    dataset, truth = read_dataset(folder), read_truth(folder / "ground_truth.json")
    lidar = next(sensor for sensor in dataset.sensors.values() if sensor.modality == LIDAR3D)
    errors, times, found = [], [], []
    for seed in range(seeds):
        collections = []
        random = np.random.default_rng(seed)
        for i, collection in enumerate(dataset.collections):
            guess = _wrong_guess(dataset, folder, i, random)
            cloud = read_points(
                folder / dataset.document["collections"][collection.key]["data"][lidar.name]["data_file"]
            )
            labels: list[object] = []
            times.append(
                seconds(lambda cloud=cloud, guess=guess, labels=labels: labels.append(label_points(cloud, *guess)))
            )
            label, kept = labels[0], {k: v for k, v in collection.labels.items() if k[1] != lidar.name}
            found.append(not isinstance(label, NotDetected))
            if not isinstance(label, NotDetected):
                points = np.asarray(cloud[label.on_pattern], float)
                limits = np.searchsorted(label.on_pattern, label.on_border)
                kept[guess[0].name, lidar.name] = PointLabels(points, limits)
            collections.append(replace(collection, labels=kept))
        result = calibrate(replace(dataset, collections=tuple(collections)))
        errors.append(distance(truth.transforms[lidar.edge], result.transforms[lidar.edge]))
    shipped = distance(truth.transforms[lidar.edge], calibrate(dataset).transforms[lidar.edge])
    worst = 1e3 * max(float(off) for off, _ in errors)
    turned = max(np.degrees(float(angle)) for _, angle in errors)
    note = f"{turned:.4f} deg; the labels that ship {1e3 * shipped[0]:.2f} mm"
    yield Row("labelling/clouds, calibration", worst, "mm", Bar(high=1.0), note)
    yield Row("labelling/clouds, found", 100 * float(np.mean(found)), "%", Bar(low=100))
    yield Row("labelling/clouds, time", 1e3 * statistics.median(times), "ms")


def _wrong_guess(dataset: Dataset, folder: Path, i: int, random: np.random.Generator) -> tuple[object, Array]:
    truth = read_truth(folder / "ground_truth.json")
    (pattern,) = dataset.patterns.values()
    lidar = next(sensor for sensor in dataset.sensors.values() if sensor.modality == LIDAR3D)
    T_world_lidar = dataset.with_transforms(truth.transforms).transform(dataset.world, lidar.frame)[i]
    ((_, T_world_pattern),) = truth.patterns[dataset.keys[i]].items()
    shift, turn = (v / np.linalg.norm(v) for v in random.normal(size=(2, 3)))
    middle = translation([*pattern.outline.mean(axis=0), 0.0])
    wrong = middle @ transform(rotations.exp(np.radians(3) * turn), 0.05 * shift) @ inverse(middle)
    return pattern, inverse(T_world_lidar) @ T_world_pattern @ wrong
