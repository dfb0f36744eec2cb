"""Real recordings, and wrong views: is what is stated true, and is what is broken red."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import FOLDER, load, missing
from benchmarks.verdict.case import harm_of, judged
from benchmarks.verdict.defects import boards, cameras, labels, motions
from benchmarks.verdict.scene import Scene
from benchmarks.verdict.strata import clean, entries, generator
from calibration.base import read_yaml
from calibration.base.arrays import Array
from calibration.engine.dataset.configuration import PatternConfiguration
from calibration.engine.dataset.modalities import MODALITIES
from calibration.engine.dataset.model import Collection, Dataset, Sensor
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.covariance.result import Calibration
from calibration.engine.estimation.options import ALL_EXACT
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import distance, from_quaternion
from calibration.pipeline.system import System
from calibration.robot.labelling.detection import NotDetected
from calibration.robot.labelling.marked_boards import CharucoDetector

ARM = FOLDER / "real-arm"
NO_ARM = "no ../shared/data/real-arm: it is not part of the project"
PAPER = "t2rgb-paper"


@cache
def real_arm() -> Dataset:
    """Photographs of an arm that holds a board before a camera, and where the arm says it is."""

    def pose(document: Mapping[str, float]) -> Array:
        return from_quaternion([document[k] for k in "xyz"], [document[f"q{k}"] for k in "xyzw"])

    printed = PatternConfiguration(
        "board", "charuco", "board", "wrist", True, (4, 6), 0.036195, 0.018256, dictionary="DICT_6X6_250"
    )
    detector, pattern = CharucoDetector(printed), printed.pattern()
    collections, T_base_wrist = [], []
    for entry in _document("cal_data.yaml"):
        image = cv2.imread(str(ARM / entry["image"]))
        found = detector.detect(image.astype(np.uint8)) if image is not None else NotDetected("no image")
        if isinstance(found, NotDetected):
            continue
        collections.append(Collection(Path(entry["image"]).stem, {("board", "camera"): found}))
        T_base_wrist.append(pose(_document(entry["pose"])))
    guesses = _document("pose_guesses.yaml")
    lens = _document("camera_intr_calibrated.yaml")["intrinsics"]
    n = len(collections)
    camera = Camera(lens["fx"], lens["fy"], lens["cx"], lens["cy"], 1600, 1200)
    return Dataset(
        path=ARM / "dataset.json",
        version="3.0",
        world="base",
        sensors={"camera": Sensor("camera", MODALITIES["rgb"], "camera", "base", "camera", camera)},
        patterns={"board": pattern},
        anchored=None,
        additional_transforms=(),
        collections=tuple(collections),
        transforms={
            ("base", "camera"): np.tile(pose(guesses["base_to_camera_guess"]), (n, 1, 1)),
            ("base", "wrist"): np.stack(T_base_wrist),
            ("wrist", "board"): np.tile(pose(guesses["wrist_to_target_guess"]), (n, 1, 1)),
        },
        document={},
    )


def _document(name: str) -> Any:
    return read_yaml(ARM / name, "a file of the recording")


def recording(name: str) -> Scene:
    """A recording as a scene: what is calibrated of all of it stands for the truth."""
    told = real_arm() if name == "real-arm" else load(name)
    entry = entries()["t2rgb"] if name == PAPER else System(name, ARM / "dataset.json")
    return Scene(entry, told, calibrate(told).dataset)


def rows(quick: bool) -> Iterator[Row]:
    """Half-samples, few images, four ways to break a recording, wrong views."""
    for name in (PAPER, "real-arm"):
        reason = missing(name) if name == PAPER else ("" if ARM.is_dir() else NO_ARM)
        if reason:
            yield Row(f"verdict/half-samples, {name}", skipped=reason)
            continue
        yield from _half_samples(name, recording(name).told, 10 if quick else 40)
        if name == "real-arm":
            yield _few_images(10 if quick else 50)
        else:
            yield from _broken()
    for name in ("t2rgb", "riwbot"):
        yield from _half_samples(name, clean("rendered", name, 0).told, 10 if quick else 40)
    yield from _wrong_views(5 if quick else 50)


def _half_samples(name: str, told: Dataset, draws: int) -> Iterator[Row]:
    """Distance of the result from half of the collections, in standard deviations stated for all of them.

    Half of the data has twice the variance, and half of that it shares with the whole: the difference has the
    variance of the whole.
    """
    whole = calibrate(told, Options(assume=ALL_EXACT))  # what is held alike in both halves cancels out
    rng = generator("half", name)
    n = len(told.collections)
    sensors = [s for s in told.sensors.values() if s.edge in whole.covariances]
    moved: dict[str, list[float]] = {s.name: [] for s in sensors}
    for _ in range(draws):
        half = calibrate(told.with_collections(sorted(rng.permutation(n)[: n // 2].tolist())))
        for sensor in sensors:
            apart = distance(half.transforms[sensor.edge], whole.transforms[sensor.edge])[0]
            moved[sensor.name].append(1e3 * float(apart))
    for sensor in sensors:
        typical = float(np.sqrt(np.mean(np.square(moved[sensor.name]))))
        stated = whole.sigma_mm(sensor.edge)
        note = f"{typical:.3g} mm, stated {stated:.3g} mm; {draws} halves of {n} collections"
        yield Row(f"verdict/half-samples, {name}, {sensor.name}", typical / stated, "sigma", Bar(0.7, 1.5), note)


def _few_images(draws: int) -> Row:
    scene = recording("real-arm")
    whole, rng = calibrate(scene.told), generator("few images")
    silent, off = [], 0
    for _ in range(draws):
        few = motions.few(scene, int(rng.integers(3, 7)), rng)
        result, _, found = judged(few)
        if found is None:
            continue
        apart = 1e3 * _apart(found, whole)
        off += apart > 5
        if apart > 5 and result.verdict == "pass" and apart > 3 * found.sigma_mm(("base", "camera")):
            silent.append(f"{len(few.told.collections)} images: {apart:.1f} mm")
    note = f"green and beyond three sigma, of {off} more than 5 mm off, {draws} draws of 3 to 6 images; {silent[:3]}"
    return Row("verdict/few images of real-arm", float(len(silent)), "", Bar(high=0), note)


def _apart(found: Calibration, whole: Calibration) -> float:
    return max(
        float(distance(found.transforms[e], whole.transforms[e])[0]) for e in whole.covariances if e[0] == "base"
    )


def _broken() -> Iterator[Row]:
    """The recording of the paper as it is, and broken in four ways: red is 1."""
    scene, rng = recording(PAPER), generator("broken")
    both = replace(scene, told=scene.told)
    for name in scene.cameras:
        camera = cameras.camera_of(scene, name)
        longer = replace(camera, fx=camera.fx * 1.05, fy=camera.fy * 1.05)
        both = replace(both, told=both.told.with_cameras({name: longer}))
    ways = {
        "as it is": scene,
        "pattern in mm": boards.unit(scene, 1000, rng),
        "labels exchanged": labels.exchanged(scene, 1.0, rng),
        "focal lengths + 5 %": both,
        "squares of 50 mm": boards.size(scene, 0.05 / 0.06 - 1, rng),
    }
    for name, broken in ways.items():
        result, _, _ = judged(broken)
        said = [*result.reasons[:2], *(f"(warning) {each}" for each in result.warnings[:2])]
        bar = Bar.around(0.0 if broken is scene else 1.0, 0)
        yield Row(f"verdict/{PAPER}, {name}", float(result.verdict == "fail"), "red", bar, "; ".join(said)[:300])


def _wrong_views(draws: int) -> Iterator[Row]:
    systems = ["t2rgb", "riwbot", "rlbot", *([] if missing(PAPER) else [PAPER])]
    for name in systems:
        scene = recording(PAPER) if name == PAPER else clean("rendered", name, 0)
        for share in (0.1, 0.2, 0.3, 0.4):
            silent, good, unnamed = _silent(name, scene, share, draws)
            note = f"{draws} draws: {good} good and green, {unnamed} red without a view named"
            yield Row(f"verdict/{share:.0%} wrong views, {name}", float(silent), "silent", Bar(high=0), note)


def _silent(name: str, scene: Scene, share: float, draws: int) -> tuple[int, int, int]:
    """Numbers of draws that are wrong and green, good and green, and red without one of the collections named."""
    counts = [0, 0, 0]
    for draw in range(draws):
        broken = labels.of_another_collection(scene, share, generator(name, share, draw))
        wrong = [
            told.key
            for told, was in zip(broken.told.collections, scene.told.collections, strict=True)
            if told.labels != was.labels
        ]
        result, _, found = judged(broken)
        limits = harm_of(found.dataset, scene) if found else None
        off = limits is not None and limits.over(scene.system.limits) > 1
        if result.verdict == "pass":
            counts[0 if off else 1] += 1
        elif not _named(result.reasons, wrong):
            counts[2] += 1
    return counts[0], counts[1], counts[2]


def _named(reasons: Sequence[str], keys: Sequence[str]) -> bool:
    return any(key in reason for reason in reasons for key in keys)
