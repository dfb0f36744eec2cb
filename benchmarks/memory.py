"""The most memory that a solve holds: ``python -m benchmarks.memory WHAT COLLECTIONS`` prints one number."""

import gc
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.rig_arrays import corner_pixels, solve
from benchmarks.scenes import rig
from calibration.engine.estimation.calibrate import Options, calibrate
from calibration.engine.estimation.start.build import build


def peak(what: str, collections: int) -> float:
    """The peak of allocated memory during a solve, its input included, over the size of the pixels."""
    tracemalloc.start()
    dataset, T_world_camera = rig(collections)
    pixels = sum(labels.nbytes for collection in dataset.collections for labels in corner_pixels(collection))
    work: Callable[[], object]
    if what == "calibrate":
        work = partial(calibrate, dataset, Options(loss="linear"))
    else:
        setup = build(dataset)
        # the arrays alone, without the objects that they were made from
        setup = replace(setup, dataset=replace(setup.dataset, collections=()))
        guess = (*T_world_camera, np.broadcast_to(np.eye(4), (collections, 4, 4)).copy())
        work = partial(solve, setup, guess, robust=what == "solve, robust")
    del dataset
    gc.collect()
    tracemalloc.reset_peak()
    work()
    return tracemalloc.get_traced_memory()[1] / pixels


if __name__ == "__main__":
    print(peak(sys.argv[1], int(sys.argv[2])))
