"""The catalogue: every kind of defect."""

import numpy as np

from benchmarks.verdict.foreseen import FORESEEN
from benchmarks.verdict.kind import Kind
from benchmarks.verdict.scene import Scene
from benchmarks.verdict.unforeseen import UNFORESEEN

KINDS = (*FORESEEN, *UNFORESEEN)


def _nothing(scene: Scene, _: float, __: np.random.Generator) -> Scene:
    return scene


CLEAN = Kind("clean", "clean", "nothing", _nothing, (0,), "", ())
