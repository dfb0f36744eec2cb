"""An outside yardstick: hand-eye sequences of ``kinhec`` with their truth, beside its own baselines.

Install ``kinhec``, generate a tier (``kinhec generate --tier small --out DIR``) and set KINHEC_DATA=DIR. Each sequence
is imported as hand-eye samples, the keyframes that kinhec's own protocol gives its solvers, and calibrated with every
default; of the track ``monocular``, whose camera knows no scale, with ``scale: free``.
"""

import csv
import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.workers import on_all_cores
from calibration.base.arrays import Array
from calibration.base.errors import CalibrationError
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.solve.options import Options
from calibration.engine.geometry.rotations import to_quaternion
from calibration.engine.geometry.transforms import inverse, local
from calibration.robot.importing.importing import import_data

DATA = "KINHEC_DATA"
POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
NEES_BAR = Bar(0.5, 1.5)
MAX_QUICK_SEQUENCES = 16
"""Sequences of a track, if quick."""


@dataclass(frozen=True)
class Score:
    """Errors of one sequence's calibration: ours, and those of kinhec's solvers."""

    mm: float
    """Error of the hand-eye transform."""
    nees: float
    """``e^T C^-1 e / 6``."""
    of_others: Mapping[str, float]
    """Errors of kinhec's solvers, mm."""


def rows(quick: bool) -> Iterator[Row]:
    """Medians of the errors of each track, against the best baseline on the same sequences, and error bars."""
    folder = os.environ.get(DATA)
    try:
        from kinhec.io import load_manifest  # only for this yardstick
    except ImportError:
        yield Row("trust/hand-eye", skipped="kinhec is not installed (pip install kinhec)")
        return
    if not folder:
        yield Row("trust/hand-eye", skipped=f"{DATA} names no folder (kinhec generate --tier small --out DIR)")
        return
    sequences = load_manifest(Path(folder))
    for track, own in sequences.groupby("track"):
        records = own.to_dict("records")[: MAX_QUICK_SEQUENCES if quick else None]
        scores = on_all_cores(_score, [(folder, record) for record in records])
        yield from _of_track(str(track), [each for each in scores if each is not None], len(scores))


def _of_track(track: str, scores: list[Score], count: int) -> Iterator[Row]:
    name, calibrated = f"trust/hand-eye, {track}", f"{len(scores)} of {count} calibrated"
    if not scores:
        yield Row(name, bar=Bar(high=0), note=calibrated)
        return
    solvers = {name: np.median([each.of_others.get(name, np.inf) for each in scores]) for name in scores[0].of_others}
    best = min(solvers, key=lambda name: solvers[name])
    yield Row(
        name,
        float(np.median([each.mm for each in scores])),
        "mm",
        Bar(high=float(solvers[best])),
        f"{best}, {calibrated}",
    )
    yield Row(f"{name}, NEES/6", float(np.mean([each.nees for each in scores])), "", NEES_BAR, calibrated)


def _score(of: tuple[str, dict[str, Any]]) -> Score | None:
    """Calibrate one sequence by all methods; None if ours refuses it."""
    from kinhec import benchmark, metrics
    from kinhec.io import _load_from_row

    sequence = _load_from_row(Path(of[0]), of[1])
    data = benchmark._keyframe_data(sequence, None if sequence.synchronous else sequence.time_offset)
    if data is None:
        return None
    T_base_tool, seen = data[0], data[1]
    in_hand = sequence.eye_in_hand
    ours = _calibrated(T_base_tool, inverse(seen) if in_hand else seen, in_hand, of[1]["track"] == "monocular")
    if ours is None:
        return None
    T, C = ours
    e = local(sequence.X, T)
    others: dict[str, float] = {}
    for name, solver in benchmark.SOLVERS.items():
        try:
            found = solver(data, np.random.default_rng(0))["X"]
            others[name] = float(metrics.calibration_errors(found, sequence.X)["X_trans_err_mm"])
        except Exception:  # of kinhec's own solvers, each with errors of its own: no result counts as infinitely far
            others[name] = np.inf
    return Score(
        1e3 * float(np.linalg.norm(T[:3, 3] - sequence.X[:3, 3])), float(e @ np.linalg.solve(C, e)) / 6, others
    )


def _calibrated(
    T_base_tool: Array, T_camera_pattern: Array, in_hand: bool, free_scale: bool
) -> tuple[Array, Array] | None:
    """Import poses (N, 4, 4) as samples; the calibrated transform on the tool and its covariance, None if refused."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with (folder / "samples.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([*POSE_COLUMNS, *("pattern_" + name for name in POSE_COLUMNS)])
            writer.writerows(
                [*_cells(tool), *_cells(seen)] for tool, seen in zip(T_base_tool, T_camera_pattern, strict=True)
            )
        on, off = ("tool0", "base_link") if in_hand else ("base_link", "tool0")
        document = {
            "sensors": {"camera": {"parent": on}},
            "patterns": {"board": {"parent": off}},
            "samples": {"file": "samples.csv", "base": "base_link", "tool": "tool0"},
        }
        (folder / "import.yml").write_text(str(document).replace("'", '"'))
        try:
            import_data(folder / "import.yml", folder / "data")
            dataset = read_dataset(folder / "data")
            found = calibrate(dataset, Options(scale="free" if free_scale else "known"))
        except CalibrationError:
            return None
        if not found.converged:
            return None
        edge = dataset.sensors["camera"].edge if in_hand else ("tool0", dataset.patterns["board"].link)
        return found.transforms[edge], found.covariances[edge]


def _cells(T: Array) -> list[float]:
    return [*T[:3, 3].tolist(), *to_quaternion(T[:3, :3]).tolist()]
