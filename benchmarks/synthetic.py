"""Three synthetic systems from 100 noisy starts each, against their truth."""

from collections.abc import Iterator
from dataclasses import replace

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import NOISE_PAIRS, missing
from benchmarks.starts import End, Start, solve, spread_mm
from benchmarks.workers import on_all_cores

MAXIMUM_LIKELIHOOD = {"t2rgb": 0.1525, "riwbot": 0.0376}
"""Error of plain least squares at its optimum, mm; computed independently."""
SAME = Bar(high=1e-3)
"""Results from all starts lie within this (mm)."""
RLBOT = Bar(high=2.5)
SIGMAS = Bar(high=3)


def measure(quick: bool) -> Iterator[Row]:
    """Four noise pairs, 25 seeds; plain least squares and the robust default."""
    for name in ("t2rgb", "riwbot", "rlbot"):
        if reason := missing(f"synthetic/{name}"):
            yield Row(f"synthetic/{name}", skipped=reason)
            continue
        starts = [Start(f"synthetic/{name}", t, r, seed) for t, r in NOISE_PAIRS for seed in range(3 if quick else 25)]
        yield from _rows(name, "plain", on_all_cores(solve, starts))
        yield from _rows(name, "robust", on_all_cores(solve, [replace(start, loss="huber") for start in starts]))


def _rows(name: str, loss: str, ends: list[End]) -> Iterator[Row]:
    first = ends[0]
    converged = sum(end.converged for end in ends)
    yield Row(f"synthetic/{name} {loss}, spread", spread_mm(ends), "mm", SAME, f"{converged} of {len(ends)} converged")
    error = max(end.translation_mm for end in ends)
    bar = RLBOT if name == "rlbot" else None
    if loss == "plain" and name in MAXIMUM_LIKELIHOOD:
        bar = Bar.around(MAXIMUM_LIKELIHOOD[name], 0.01 * MAXIMUM_LIKELIHOOD[name])
    note = f"{first.rotation_deg:.5f} deg; stated {first.sigma_mm:.3f} mm, {first.sigma_deg:.4f} deg"
    yield Row(f"synthetic/{name} {loss}, error", error, "mm", bar, note)
    sigmas = max(first.translation_mm / first.sigma_mm, first.rotation_deg / first.sigma_deg)
    yield Row(f"synthetic/{name} {loss}, in its sigmas", sigmas, "sigma", SIGMAS if name == "rlbot" else None)
