"""mrcal, in a process of the Python that has it."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.peers.peer import Peer, PeerError, Solution
from benchmarks.rig_arrays import RigArrays

PYTHONS = ("/usr/bin/python3", sys.executable)


def mrcal() -> Peer | str:
    """The solver, or why there is none."""
    for python in PYTHONS:
        if Path(python).exists() and not subprocess.run([python, "-c", "import mrcal"], capture_output=True).returncode:
            return lambda rig: _solve(python, rig)
    return f"{' and '.join(PYTHONS)} cannot import mrcal; on Debian: apt-get install python3-mrcal"


def _solve(python: str, rig: RigArrays) -> Solution:
    script = Path(__file__).with_name("mrcal_script.py")
    with tempfile.TemporaryDirectory() as folder:
        start, solution = Path(folder, "start.npz"), Path(folder, "solution.npz")
        rig.save(start)
        done = subprocess.run([python, script, start, solution], capture_output=True, text=True)
        if done.returncode:
            raise PeerError(f"mrcal failed: {' '.join(done.stderr.split())[-200:]}")
        with np.load(solution) as found:
            poses = found["T_camera_world"], found["T_world_board"]
            return Solution(*poses, float(found["seconds"]), found["intrinsics"] if rig.free_intrinsics else None)
