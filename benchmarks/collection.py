"""Whole collections in simulation: how fast, and how near the truth their calibrations come."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.rows import Bar, Row
from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionRequest

DATASETS = Path(__file__).parents[1] / "datasets"
POSES = {"t2rgb": 22, "rlbot": 24, "riwbot": 24}
SECONDS = 5.0
"""For 22 poses of t2rgb, the whole process (the paper: 220 s of waiting, 7 min 51 s a job)."""
MOST_MM, MOST_DEG = {"t2rgb": 1.0, "rlbot": 5.0, "riwbot": 1.0}, {"t2rgb": 0.1, "rlbot": 0.3, "riwbot": 0.1}


def measure(quick: bool) -> Iterator[Row]:
    """Measure each system that ships, from nothing to a calibrated dataset."""
    with tempfile.TemporaryDirectory() as folder:
        yield _process(Path(folder, "process"), 1 if quick else 3)
        for system, poses in POSES.items():
            yield from _collection(system, poses, Path(folder, system))


def _process(output: Path, rounds: int) -> Row:
    """The least time of the command as a user runs it."""
    motion = f"generate:{POSES['t2rgb']}"
    command = [sys.executable, "-m", "calibration", "collect-data-sim", "--system", str(DATASETS / "t2rgb")]
    times = []
    for _ in range(rounds):
        begin = time.perf_counter()
        subprocess.run(
            [*command, "--motion", motion, "--overwrite", "--output", str(output)], check=True, capture_output=True
        )
        times.append(time.perf_counter() - begin)
    note = f"{POSES['t2rgb']} poses, with images, contact sheet and calibration"
    return Row("collection/t2rgb process", min(times), "s", Bar(high=SECONDS), note)


def _collection(system: str, poses: int, output: Path) -> Iterator[Row]:
    begin = time.perf_counter()
    results = collect_dataset(CollectionRequest(DATASETS / system, motion=f"generate:{poses}"), output)
    seconds = time.perf_counter() - begin
    proof = results.proof
    kept = f"{len(results.kept)} of {poses} kept"
    yield Row(f"collection/{system} speed", poses / seconds, "collections/s", note=kept)
    if results.corner_rms is not None:
        yield Row(f"collection/{system} corners", results.corner_rms, "px", note="RMS against the truth")
    if proof is None or proof.translation_mm is None or proof.rotation_deg is None:
        yield Row(f"collection/{system} calibrates", bar=Bar(high=0), note=proof.reason if proof else "nothing kept")
        return
    sigma = max((s.translation_mm for s in (proof.sigmas or {}).values()), default=0.0)
    note = f"against the truth; its own sigma {sigma:.3f} mm"
    yield Row(f"collection/{system} translation", proof.translation_mm, "mm", Bar(high=MOST_MM[system]), note)
    yield Row(f"collection/{system} rotation", proof.rotation_deg, "deg", Bar(high=MOST_DEG[system]))
