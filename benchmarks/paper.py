"""The t2rgb dataset of the paper from 400 noisy starts: four noise pairs, seeds 0 to 99."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import NOISE_PAIRS, missing
from benchmarks.starts import End, Start, solve, spread_mm
from benchmarks.workers import on_all_cores

DATASET, EVALUATION = "t2rgb-paper", ("right_camera", "left_camera")
OPTIMUM = Bar.around(0.6004, 0.0003)
"""Averages RMS of the evaluation at the optimum of plain least squares, px."""


def measure(quick: bool) -> Iterator[Row]:
    """Plain least squares, the robust default, and the start that ATOM has."""
    if reason := missing(DATASET):
        yield Row("paper", skipped=reason)
        return
    seeds = range(5 if quick else 100)
    starts = [Start(DATASET, t, r, seed, evaluate=EVALUATION) for t, r in NOISE_PAIRS for seed in seeds]
    yield from _plain(on_all_cores(solve, starts))
    yield from _robust(on_all_cores(solve, [replace(start, loss="huber") for start in starts]))
    yield from _given(on_all_cores(solve, [replace(start, start="given") for start in starts]), len(seeds))


def _plain(ends: list[End]) -> Iterator[Row]:
    rms = [end.rms for end in ends]
    reached = sum(end.converged and OPTIMUM.holds(end.rms) for end in ends)
    note = f"{reached} of {len(ends)}, Averages RMS {min(rms):.4f} to {max(rms):.4f} px, {spread_mm(ends):.1e} mm apart"
    yield Row("paper/optimum reached", 100 * reached / len(ends), "%", Bar(low=100), note)
    yield Row("paper/RMS", float(np.median(rms)), "px", OPTIMUM)
    note = "the worst start, camera to camera against the truth"
    yield Row("paper/translation", float(np.max([end.translation_mm for end in ends])), "mm", Bar(high=0.5), note)
    yield Row("paper/rotation", float(np.max([end.rotation_deg for end in ends])), "deg", Bar(high=0.05), note)


def _robust(ends: list[End]) -> Iterator[Row]:
    rms = [end.rms for end in ends]
    share = 100 * sum(end.converged for end in ends) / len(ends)
    note = f"RMS {rms[0]:.4f} px; {ends[0].translation_mm:.3f} mm, {ends[0].rotation_deg:.4f} deg"
    yield Row("paper/robust, RMS apart by", float(np.ptp(rms)), "px", Bar(high=1e-4), note)
    yield Row("paper/robust, converged", share, "%", Bar(low=100))


def _given(ends: list[End], seeds: int) -> Iterator[Row]:
    for k, (t, r) in enumerate(NOISE_PAIRS):
        part = ends[k * seeds : (k + 1) * seeds]
        share = 100 * sum(end.converged for end in part) / seeds
        elsewhere = sum(end.converged and not OPTIMUM.holds(end.rms) for end in part)
        note = f"start given: the share that says it has converged; {elsewhere} of them elsewhere"
        yield Row(f"paper/given, {t:g} m {r:g} rad", share, "%", note=note)
