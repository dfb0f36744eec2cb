"""An outside yardstick: hand-eye sequences of ``kinhec`` with their truth, beside its own baselines.

Install ``kinhec``, generate a tier (``kinhec generate --tier small --out DIR``) and set KINHEC_DATA=DIR. Each sequence
is imported as hand-eye samples, the keyframes that kinhec's own protocol gives its solvers, and calibrated with every
default; where its camera knows no scale, with ``scale: free``, and once without, to see whether that is named.
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
from calibration.base import CalibrationError
from calibration.base.arrays import Array
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.estimation.calibrate import calibrate
from calibration.engine.estimation.covariance.calibrated import covariances_of_transforms
from calibration.engine.estimation.covariance.fixed_inputs import SCALE_KIND
from calibration.engine.estimation.covariance.suspects import explain
from calibration.engine.estimation.options import Options
from calibration.engine.geometry.rotations import to_quaternion
from calibration.engine.geometry.transforms import inverse, local
from calibration.robot.importing.importing import import_data

DATA = "KINHEC_DATA"
POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
NEES_BAR = Bar(0.5, 1.5)
MAX_QUICK_SEQUENCES = 12
"""Sequences of a track, spread over all of its factors, if quick."""


@dataclass(frozen=True)
class Score:
    """Errors of one sequence's calibration: ours, and those of kinhec's solvers."""

    mm: float
    """Error of the hand-eye transform."""
    nees: float
    """``e^T C^-1 e / 6``."""
    nees_of_exact_arm: float
    """The same without what an arm is assumed to be off by: most of kinhec's arms are exact but for noise."""
    scale_is_named: bool | None
    """Whether the verdict names an unknown scale that is not free; None for poses in metres."""
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
        records = own.to_dict("records")
        if quick:
            picked = np.linspace(0, len(records) - 1, min(MAX_QUICK_SEQUENCES, len(records))).round().astype(int)
            records = [records[i] for i in picked]
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
    exact = np.mean([each.nees_of_exact_arm for each in scores])
    note = f"{calibrated}; {exact:.2f} if the arm is assumed to be exact"
    yield Row(f"{name}, NEES/6", float(np.mean([each.nees for each in scores])), "", NEES_BAR, note)
    named = [each.scale_is_named for each in scores if each.scale_is_named is not None]
    if named:
        yield Row(f"{name}, unknown scale named", 100 * float(np.mean(named)), "%", Bar(low=90), f"of {len(named)}")


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
    free_scale = bool(sequence.config.scale.get("enabled"))
    with tempfile.TemporaryDirectory() as name:
        try:
            dataset = _imported(Path(name), T_base_tool, inverse(seen) if in_hand else seen, in_hand)
            found = calibrate(dataset, Options(scale="free" if free_scale else "known"))
        except CalibrationError:
            return None
        if found.error_bars is None:
            return None
        scale_is_named = _names_scale(dataset) if free_scale else None
    edge = dataset.sensors["camera"].edge if in_hand else ("tool0", dataset.patterns["board"].link)
    expected = covariances_of_transforms(found.solution.setup, found.error_bars.expected)
    C, by_arm = found.covariances[edge], expected[edge] - found.label_covariances[edge]
    e = local(sequence.X, found.transforms[edge])
    others: dict[str, float] = {}
    for name, solver in benchmark.SOLVERS.items():
        try:
            found = solver(data, np.random.default_rng(0))["X"]
            others[name] = float(metrics.calibration_errors(found, sequence.X)["X_trans_err_mm"])
        except Exception:  # of kinhec's own solvers, each with errors of its own: no result counts as infinitely far
            others[name] = np.inf
    nees, nees_of_exact_arm = (float(e @ np.linalg.solve(each, e)) / 6 for each in (C, C - by_arm))
    return Score(1e3 * float(np.linalg.norm(e[:3])), nees, nees_of_exact_arm, scale_is_named, others)


def _names_scale(dataset: Dataset) -> bool:
    """Return whether a calibration that takes the scale as known names it, as an error or as a cause."""
    try:
        found = calibrate(dataset, Options())
    except CalibrationError as error:
        return "the scale of the measured poses is unknown" in str(error)
    explanation = explain(found.solution.model) if found.error_bars else None
    return explanation is not None and any(each.cause.kind == SCALE_KIND for each in explanation.suspects)


def _imported(folder: Path, T_base_tool: Array, T_camera_pattern: Array, in_hand: bool) -> Dataset:
    """Import poses (N, 4, 4) as samples."""
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
    import_data(folder / "import.yml", folder / "data")
    return read_dataset(folder / "data")


def _cells(T: Array) -> list[float]:
    return [*T[:3, 3].tolist(), *to_quaternion(T[:3, :3]).tolist()]
