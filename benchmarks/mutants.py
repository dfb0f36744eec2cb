"""The engine with one line broken, on the same data: RMS limits let it pass, the accepted baseline does not."""

import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.shared_data import ROOT
from calibration.engine.baseline.calibration_document import CalibrationDocument
from calibration.engine.baseline.document import read_baseline
from calibration.engine.baseline.quality import BASELINE_FILE
from calibration.engine.geometry.transforms import local

MODULES = (
    *(f"estimation/residuals/{name}.py" for name in ("views", "corner_residuals", "ray_residuals", "pose_residuals")),
    "estimation/problem/problem.py",
    *(f"estimation/least_squares/{name}.py" for name in ("normal_equations", "minimisation", "noise_levels")),
    *(f"estimation/start/{name}.py" for name in ("build", "wrong_views")),
    *(
        f"geometry/{name}.py"
        for name in ("cameras", "lenses/pinhole", "lenses/wide", "transforms", "rotations", "frames")
    ),
    "dataset/pattern.py",
)
"""Files of `calibration/engine`."""
SURVIVORS = 30
TRIED = 400
SECONDS = 120
NOTHING = 0.03
"""A change by so many standard deviations, or of error bars by this part, is none that matters to anyone."""
CONFIGURATION = """\
assume: exact
systems:
  t2rgb: {dataset: DATASETS/t2rgb, evaluate: "rgb-to-rgb:right_camera:left_camera", truth: none, limits: {rms-px: 0.3}}
  rlbot: {dataset: DATASETS/rlbot, evaluate: "lidar-to-rgb:lidar_right:rgb_left", truth: none, limits: {rms-px: 6}}
  riwbot: {dataset: DATASETS/riwbot, truth: none, limits: {rms-px: 0.4}}
  spjbot: {dataset: DATASETS/spjbot, truth: none, limits: {rms-px: 0.4}}
"""
"""RMS limits of three times a good run, which is what a team would set."""


def measure(quick: bool) -> Iterator[Row]:
    """Mutants that pass the RMS limits and give another result: how many the baseline finds."""
    wanted = 8 if quick else SURVIVORS
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(os.cpu_count()) as pool:
        base = Path(temporary) / "as it is"
        _prepare(base)
        assert _run(base, "run") == _run(base, "accept") == 0
        found, survived, tried = [], 0, 0
        mutants = _mutants()
        while survived < wanted and tried < TRIED:
            batch = [next(mutants) for _ in range(2 * (os.cpu_count() or 1))]
            for what, verdict in pool.map(lambda each: _verdict(base, Path(temporary), each), batch):
                tried += 1
                if verdict is not None:
                    survived += 1
                    found.append((what, verdict))
    missed = [what for what, red in found if not red]
    note = (
        f"of {survived} that pass RMS limits of three times a good run, of {tried}; missed: {', '.join(missed) or '-'}"
    )
    yield Row("baseline/mutants of the engine", 100 * (1 - len(missed) / max(survived, 1)), "% red", Bar(low=99), note)


def _prepare(folder: Path) -> None:
    shutil.copytree(ROOT / "calibration", folder / "calibration", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "calibration.yml").write_text(CONFIGURATION.replace("DATASETS", str(ROOT / "datasets")))


def _verdict(base: Path, temporary: Path, mutant: tuple[str, str, str]) -> tuple[str, bool | None]:
    """Whether the baseline finds a mutant; None where the RMS limits do, or nothing changes at all."""
    module, text, what = mutant
    with tempfile.TemporaryDirectory(dir=temporary) as name:
        folder = Path(name)
        _prepare(folder)
        (folder / "calibration" / "engine" / module).write_text(text)
        if _run(folder, "run") != 0 or _run(folder, "accept") != 0:
            return what, None
        before, now = read_baseline(base / BASELINE_FILE), read_baseline(folder / BASELINE_FILE)
        assert before
        assert now
        change = max(_change_of_results(before.systems[name], now.systems[name]) for name in before.systems)
        if change < NOTHING:
            return what, None
        shutil.copy(base / BASELINE_FILE, folder / BASELINE_FILE)
        return f"{what} ({change:.2g})", _run(folder, "run") == 1


def _change_of_results(before: CalibrationDocument, now: CalibrationDocument) -> float:
    """The largest change of a pose in its standard deviations, and of an error bar relative to it."""
    found = [
        max(
            np.abs(local(a.matrix, b.matrix) / np.sqrt(np.diagonal(C))).max(),
            np.abs(np.sqrt(np.diagonal(D) / np.diagonal(C)) - 1).max(),
        )
        for a, b in zip(before.poses, now.poses, strict=True)
        if (C := a.covariance) is not None and (D := b.covariance) is not None
    ]
    return float(max(found))


def _run(folder: Path, command: str) -> int:
    variables = {**os.environ, "PYTHONPATH": "", "OPENBLAS_NUM_THREADS": "1"}
    arguments = ["--only", "calibrate,introspect", "--jobs", "1"] if command == "run" else []
    try:
        return subprocess.run(
            [sys.executable, "-m", "calibration", command, *arguments],
            cwd=folder,
            env=variables,
            capture_output=True,
            timeout=SECONDS,
            check=False,
        ).returncode
    except subprocess.TimeoutExpired:
        return -1


def _mutants() -> Iterator[tuple[str, str, str]]:
    """Module, its text with one operator or number changed, and what was changed; in an order drawn by a seed."""
    places = []
    for module in MODULES:
        tree = ast.parse((ROOT / "calibration" / "engine" / module).read_text())
        places += [(module, i) for i, node in enumerate(ast.walk(tree)) if _change(node) is not None]
    random.Random(7).shuffle(places)
    for module, number in places:
        tree = ast.parse((ROOT / "calibration" / "engine" / module).read_text())
        node = list(ast.walk(tree))[number]
        what = _change(node)
        yield module, ast.unparse(tree), f"{module}:{getattr(node, 'lineno', 0)} {what}"


def _change(node: ast.AST) -> str | None:
    """Change a node in place, and say how; None where there is nothing to change."""
    if isinstance(node, ast.BinOp):
        for kind, other in ((ast.Add, ast.Sub), (ast.Sub, ast.Add), (ast.Mult, ast.Div), (ast.Div, ast.Mult)):
            if isinstance(node.op, kind):
                node.op = other()
                return f"{kind.__name__} -> {other.__name__}"
    if isinstance(node, ast.Constant) and isinstance(node.value, float):
        old, node.value = node.value, 1.1 * node.value or 0.1
        return f"{old} -> {node.value:.3g}"
    return None


if __name__ == "__main__":
    for row in measure("--quick" in sys.argv):
        print(row.line(), flush=True)
