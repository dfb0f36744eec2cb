"""The engine in units of one numpy pass over the data (`benchmarks.floor`)."""

from collections.abc import Iterator

from benchmarks.floor import one_pass
from benchmarks.rig_arrays import rig_problem, solve
from benchmarks.rows import Bar, Row
from benchmarks.scenes import rig
from benchmarks.timing import in_units_of
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.least_squares.minimisation import minimise
from calibration.engine.estimation.least_squares.normal_equations import Weighting
from calibration.engine.estimation.start.linear_start import linear_start

COLLECTIONS = 2000


def measure(quick: bool) -> Iterator[Row]:
    """2 cameras, 2000 collections, 50 corners each."""
    scene = rig_problem(COLLECTIONS)
    dataset, _ = rig(COLLECTIONS)
    setup, problem = scene.setup, scene.setup.problem

    unit, ratios = in_units_of(
        lambda: one_pass(scene.arrays),
        {
            "linear start": lambda: linear_start(setup, scene.guess),
            "least squares": lambda: minimise(problem, scene.start, Weighting({"pixel": 1.0}, None)),
            "whole solve": lambda: solve(setup, scene.guess, robust=False),
            "whole solve, robust": lambda: solve(setup, scene.guess, robust=True),
            "calibrate, plain": lambda: calibrate(dataset, Options(loss="linear")),
            "calibrate, robust": lambda: calibrate(dataset),
        },
        rounds=5 if quick else 15,
    )
    yield Row("speed/pass", 1e3 * unit, "ms", note="the unit: residuals, Jacobian and 7x7 Gram of 4000 x 50 corners")
    bars = {"least squares": Bar(high=9), "whole solve": Bar(high=12)}
    notes = {
        "linear start": "every view's pose from its pixels, averaged",
        "least squares": "Levenberg-Marquardt from the linear start, plain loss",
        "whole solve": "from arrays of pixels: linear start, least squares, noise level",
        "whole solve, robust": "the same with the default loss and its weights",
        "calibrate, plain": "from a Dataset object to the typed result: checks, arrays, solve, covariance, residuals",
        "calibrate, robust": "the default",
    }
    for name, ratio in ratios.items():
        yield Row(f"speed/{name}", ratio, "passes", bars.get(name), notes[name])
