"""Patterns that are not as they are described."""

from dataclasses import replace

import numpy as np

from benchmarks.verdict.scene import Scene
from calibration.base.arrays import Array
from calibration.engine.dataset.model import CornerLabels, Labels
from calibration.engine.dataset.pattern import Pattern


def _told(scene: Scene, pattern: Pattern) -> Scene:
    return replace(scene, told=replace(scene.told, patterns={pattern.name: pattern}))


def _stretched(scene: Scene, x: float, y: float) -> Scene:
    pattern = scene.pattern
    factors = np.array([x, y, 1.0])
    return _told(scene, replace(pattern, corners=pattern.corners * factors, outline=pattern.outline * factors[:2]))


def size(scene: Scene, share: float, _: np.random.Generator) -> Scene:
    """Squares that are told too large by a share."""
    return _stretched(scene, 1 + share, 1 + share)


def unit(scene: Scene, factor: float, _: np.random.Generator) -> Scene:
    """Millimetres, centimetres or inches in the place of metres."""
    return _stretched(scene, factor, factor)


def stretch(scene: Scene, share: float, _: np.random.Generator) -> Scene:
    """Squares that are no squares: a printer that stretches."""
    return _stretched(scene, 1 + share, 1.0)


def bow_x(scene: Scene, height: float, _: np.random.Generator) -> Scene:
    """Bent along x, m in the middle."""
    return scene.seen_as_in(replace(scene, shape=tuple(np.add(scene.shape, (height, 0, 0)).tolist())))


def bow_y(scene: Scene, height: float, _: np.random.Generator) -> Scene:
    """Bent along y."""
    return scene.seen_as_in(replace(scene, shape=tuple(np.add(scene.shape, (0, height, 0)).tolist())))


def twist(scene: Scene, height: float, _: np.random.Generator) -> Scene:
    """Two opposite corners stand out, the others back."""
    return scene.seen_as_in(replace(scene, shape=tuple(np.add(scene.shape, (0, 0, height)).tolist())))


def bowed_and_stretched(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """A print that is stretched by a share on a board that is bent, half as many metres in the middle."""
    return stretch(bow_x(scene, share / 2, rng), share, rng)


def _printed(scene: Scene, corners: Array) -> Scene:
    """The scene with the corners (K, 3) of the pattern printed elsewhere."""
    real = replace(next(iter(scene.world.patterns.values())), corners=corners)
    return scene.seen_as_in(replace(scene, world=replace(scene.world, patterns={real.name: real})))


def uneven_print(scene: Scene, size: float, _: np.random.Generator) -> Scene:
    """Columns that lie wider and wider apart: the middle ones are off by so many metres."""
    corners = next(iter(scene.world.patterns.values())).corners.copy()
    x = (corners[:, 0] - corners[:, 0].min()) / np.ptp(corners[:, 0])
    corners[:, 0] -= 4 * size * x * (1 - x)
    return _printed(scene, corners)


def exchanged_board(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """From one of the collections on another board, whose squares are larger by a share."""
    other = _printed(scene, scene.pattern.corners * (1 + share))
    n = len(scene.told.collections)
    first = int(rng.integers(n // 4, 3 * n // 4 + 1))
    collections = (*scene.told.collections[:first], *other.told.collections[first:])
    return replace(scene, told=replace(scene.told, collections=collections))


def border(scene: Scene, width: float, _: np.random.Generator) -> Scene:
    """A border that is told too wide, m."""
    pattern = scene.pattern
    middle = pattern.outline.mean(0)
    return _told(scene, replace(pattern, outline=pattern.outline + width * np.sign(pattern.outline - middle)))


def dimensions(scene: Scene, way: float, _: np.random.Generator) -> Scene:
    """1: one column too few, 2: one too many, 3: columns and rows exchanged; the ids count on as before."""
    pattern = scene.pattern
    columns = 1 + int(np.argmax(np.diff(pattern.corners[:, 0]) < 0))
    rows = len(pattern.corners) // columns
    square = pattern.corners[1, 0] - pattern.corners[0, 0]
    if way == 3:
        columns, rows = rows, columns
    else:
        columns, rows = columns + (-1 if way == 1 else 1), rows + 2
    row, column = np.divmod(np.arange(columns * rows), columns)
    corners: Array = pattern.corners[0] + square * np.stack([column, row, 0 * row], 1)
    ids = len(corners)

    def known(_: int, __: str, labels: Labels) -> Labels | None:
        if not isinstance(labels, CornerLabels):
            return labels
        here = labels.ids < ids
        return replace(labels, ids=labels.ids[here], pixels=labels.pixels[here]) if here.sum() >= 4 else None

    return _told(scene, replace(pattern, corners=corners)).labelled(known)
