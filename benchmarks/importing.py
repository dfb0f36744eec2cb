"""Imports of bags: images and bytes a second, memory; whether what `init` writes passes, and finds a moved camera."""

import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from shutil import copy
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import yaml

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import FOLDER, ROOT, missing
from calibration.base.arrays import Array
from calibration.engine.baseline.calibration_document import document_of_calibration
from calibration.engine.baseline.quality import BaselineSettings
from calibration.engine.baseline.verdict import Accepted, against_baseline
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.engine.geometry.transforms import apply, inverse, translation
from calibration.pipeline.configuration import read_configuration
from calibration.pipeline.first_configuration import first_configuration
from calibration.pipeline.matrix.cell_result import Cell
from calibration.pipeline.matrix.loaded_system import LoadedSystem, load
from calibration.pipeline.matrix.running_cell import calibrate_cell
from calibration.robot.importing.bags.bag import open_bag
from calibration.robot.importing.bags.messages import image_of
from tests.robot.importing.bags import BEGIN, SECOND, BagFile
from tests.robot.importing.conftest import BOARD

SYSTEMS = ("t2rgb", "riwbot", "rlbot", "softbot", "spjbot")
PAPER = "t2rgb-paper"
MOVED = 0.005
"""How far a camera is moved in the middle of a recording, m."""
WATCHED = """
import resource, sys, threading, time
from pathlib import Path
import psutil
from calibration.robot.importing.importing import import_data
most, own, me = 0, 0.0, psutil.Process()
def watch():
    global most, own
    while True:
        try:
            most = max(most, sum(each.memory_info().rss for each in (me, *me.children(recursive=True))))
        except psutil.Error:
            pass
        own = time.thread_time()
        time.sleep(0.05)
threading.Thread(target=watch, daemon=True).start()
import_data(Path(sys.argv[1]), Path(sys.argv[2]), jobs=2)
print(most, own)
"""
"""Prints the most memory of an import and its processes together, bytes, and the CPU time of watching it, s."""


def measure(quick: bool) -> Iterator[Row]:
    """Bags of t2rgb's images as bgr8 of 640x480; then `init`."""
    with TemporaryDirectory() as folder:
        yield from _bags(Path(folder), 300 if quick else 600, 600 if quick else 2200)
    for name in SYSTEMS:
        yield from _init(name, ROOT / "datasets" / name)
    if reason := missing(PAPER):
        yield Row(f"importing/init, {PAPER}", skipped=reason)
    else:
        yield from _init(PAPER, FOLDER / PAPER)


def _bags(folder: Path, short: int, long: int) -> Iterator[Row]:
    _record(folder / "short", short)
    wall, cpu, memory = _import(folder, "short")
    yield Row(
        "importing/images",
        short / wall,
        "1/s",
        Bar(low=100),
        f"with detection, two processes; {short / cpu:.0f} a second of CPU; {memory / 1e6:.0f} MB",
    )
    yield Row(
        "importing/processor",
        1e3 * cpu / short,
        "ms",
        Bar(high=20),
        "CPU time an image, bag to labels",
    )
    times = {ours: min(_decoding(folder / "short", ours) for _ in range(3)) for ours in (False, True)}
    size = short * 640 * 480 * 3 / 1e6
    note = f"CPU time; the library alone, reading and decoding: {size / times[False]:.0f} MB/s"
    yield Row("importing/decoding", size / times[True], "MB/s", Bar(low=min(300, 0.8 * size / times[False])), note)
    (folder / "short" / "short.mcap").unlink()
    _record(folder / "long", long)
    size = sum(file.stat().st_size for file in (folder / "long").iterdir()) / 1e9
    wall, cpu, memory = _import(folder, "long")
    note = f"a bag of {size:.1f} GB, {long / wall:.0f} images a second, {long / cpu:.0f} a second of CPU"
    yield Row("importing/memory", memory / 1e6, "MB", Bar(high=500), note)


def _record(path: Path, count: int) -> None:
    """A bag of one camera, which sees another pose every second."""
    images = [np.asarray(cv2.imread(str(file))) for file in sorted((ROOT / "datasets/t2rgb").glob("left_camera_*.jpg"))]
    with BagFile(path, "mcap") as bag:
        for n in range(count):
            stamp = BEGIN + n * SECOND
            bag.camera_info("/left/camera_info", stamp, "left", (640, 480), 554.256)
            bag.image("/left/image_raw", stamp, images[n % len(images)], "left")


def _import(folder: Path, name: str) -> tuple[float, float, float]:
    """Wall and CPU time, s, and the most memory, bytes."""
    config = folder / f"{name}.yml"
    config.write_text(yaml.safe_dump({"bags": {"files": [name]}, "patterns": {"board": BOARD}}))
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, str(config), str(folder / f"{name}-out")],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    memory, watching = map(float, done.stdout.split())
    return wall, cpu - watching, memory


def _decoding(path: Path, ours: bool) -> float:
    """CPU time of reading all images of a bag, s: as arrays, or as the library gives them."""
    start = time.process_time()
    with open_bag([path]) as bag:
        for message in bag.messages({"/left/image_raw"}):
            content = bag.decode(message)
            if ours:
                image_of(content, "image")
    return time.process_time() - start


def _init(name: str, source: Path) -> Iterator[Row]:
    """Whether a dataset passes by what `init` writes, and is red where a camera moves from its middle on."""
    with TemporaryDirectory() as folder:
        root = Path(folder)
        (root / name).mkdir()
        for file in source.iterdir():
            if file.is_file() and file.suffix not in (".jpg", ".png"):
                copy(file, root / name)
        first = first_configuration(root / name, root)
        yield Row(f"importing/init, {name}", float(not first.reasons), "", Bar(low=1), "; ".join(first.reasons))
        (root / "calibration.yml").write_text(first.text)
        (system,) = read_configuration(root / "calibration.yml").systems
        yield from _moved(name, replace(load(system), truth=None))


def _moved(name: str, system: LoadedSystem) -> Iterator[Row]:
    """Whether a camera that stands elsewhere is red: since the recording that was accepted, or from a middle on."""
    camera = next(each.name for each in system.dataset.sensors.values() if each.modality.has_corners)
    accepted = calibrate(system.dataset, system.options)
    settings, cell = BaselineSettings(), Cell(name, StartingNoise())
    moved = with_moved_camera(system.dataset, accepted.dataset, camera, 0)
    before, now = (
        document_of_calibration(calibrate(each, system.options), each, None, system.options)
        for each in (system.dataset, moved)
    )
    _, findings = against_baseline(Accepted(settings, before), now)
    red = [each.text for each in findings if each.severity == "red"]
    yield Row(f"importing/moved since, {name}", float(bool(red)), "", Bar(low=1), "; ".join(red)[:150])
    moved = with_moved_camera(system.dataset, accepted.dataset, camera, len(system.dataset.collections) // 2)
    result, _ = calibrate_cell(cell, replace(system, dataset=moved))
    noticed = [each.text for each in result.findings if "moved" in each.text]
    allowed = (system.limits.translation_mm or 0.0) >= 1e3 * MOVED
    why = (*result.reasons, *noticed, "not noticed")[0]
    note = f"{'the limit that init writes is as large: ' if allowed else ''}{why}"[:150]
    yield Row(f"importing/moves, {name}", float(bool(result.reasons)), "", None if allowed else Bar(low=1), note)


def with_moved_camera(dataset: Dataset, found: Dataset, name: str, first: int) -> Dataset:
    """The dataset with the corners that a camera would see, if it stood `MOVED` m to its right.

    Args:
        dataset: as it was recorded.
        found: calibrated.
        name: of the camera.
        first: the index of the collection from which on it has moved.
    """
    sensor = dataset.sensors[name]
    camera = sensor.camera
    if camera is None:
        raise ValueError("a camera has intrinsics")
    collections = list(dataset.collections)
    for pattern in dataset.patterns.values():
        used = [i for i, _ in found.detections(pattern.name, name)]
        poses = found.with_collections(used).transform(sensor.frame, pattern.link)
        at = {found.keys[i]: T for i, T in zip(used, poses, strict=True)}
        for i, label in dataset.detections(pattern.name, name):
            if i >= first and isinstance(label, CornerLabels) and dataset.keys[i] in at:
                seen: Array = at[dataset.keys[i]]
                corners = pattern.corners[label.ids]
                shift = camera.project(apply(inverse(translation([MOVED, 0, 0])) @ seen, corners))
                pixels = label.pixels + shift - camera.project(apply(seen, corners))
                labels = {**collections[i].labels, (pattern.name, name): CornerLabels(label.ids, pixels)}
                collections[i] = replace(collections[i], labels=labels)
    return replace(dataset, collections=tuple(collections))
