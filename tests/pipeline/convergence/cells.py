"""Cells of a sweep made by hand: what converges is said by a function."""

from collections.abc import Callable
from dataclasses import replace

from calibration.base import ExitCode
from calibration.engine.estimation.options import Start
from calibration.engine.estimation.start.guesses import StartingNoise
from calibration.pipeline.convergence.convergence_map import ConvergenceMap, maps_of
from calibration.pipeline.matrix.cell_result import OUR_METHOD, Cell, CellResult, nothing_yet
from calibration.pipeline.system import NoiseGrid


def cell(
    t: float,
    r: float,
    seed: int = 1,
    converged: bool = True,
    method: str = OUR_METHOD,
    start: Start = "given",
    system: str = "arm",
    rms_px: float | None = 0.5,
    reason: str = "a false minimum",
    error: ExitCode | None = None,
) -> CellResult:
    found = nothing_yet(Cell(system, StartingNoise(t, r, seed), start), method)
    if converged:
        return replace(found, converged=True, rms_px=rms_px)
    return replace(found.failing(reason), error=error)


def one_map(
    translations: tuple[float, ...],
    rotations: tuple[float, ...],
    converges: Callable[[float, float, int], bool],
    seeds: tuple[int, ...] = (1,),
    system: str = "arm",
    error: ExitCode | None = None,
) -> ConvergenceMap:
    noise = NoiseGrid(translations, rotations, seeds)
    cells = [
        cell(t, r, seed, converges(t, r, seed), system=system, error=error)
        for t in translations
        for r in rotations
        for seed in seeds
    ]
    [found] = maps_of(cells, noise)
    return found
