"""ceres in C++, compiled for the measurement: one block of residuals per view, derived automatically."""

import atexit
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.peers.peer import Peer, PeerError, Solution
from benchmarks.rig_arrays import RigArrays
from calibration.base.arrays import Array
from calibration.engine.geometry import rotations
from calibration.engine.geometry.transforms import transform

INCLUDE = ("/usr/include/eigen3", "/usr/local/include/eigen3")
HEADER = Path("/usr/include/ceres/ceres.h")


def ceres() -> Peer | str:
    """The solver, or why there is none."""
    if shutil.which("g++") is None or not HEADER.exists():
        return "ceres is compiled by g++ with its headers; on Debian: apt-get install g++ libceres-dev"
    return _solve


def _solve(rig: RigArrays) -> Solution:
    C, N = len(rig.T_camera_world), len(rig.T_world_board)
    numbers = [C, N, len(rig.corners), rig.intrinsics, rig.corners, np.swapaxes(rig.pixels, 1, 2)]
    start = np.concatenate([np.ravel(each) for each in (*numbers, pose_vectors(rig))])
    done = subprocess.run([_program()], input=start.astype(float).tobytes(), capture_output=True)
    if done.returncode:
        raise PeerError(f"ceres failed: {done.stderr.decode(errors='replace').strip()[-200:]}")
    seconds, *poses = np.frombuffer(done.stdout)
    T = poses_of(np.array(poses))
    return Solution(T[:C], T[C:], float(seconds))


@cache
def _program() -> Path:
    """Compile the program, for this process; its folder is removed when the process ends."""
    folder = tempfile.mkdtemp()
    atexit.register(shutil.rmtree, folder)
    program = Path(folder, "ceres_peer")
    source = Path(__file__).with_name("ceres_peer.cpp")
    options = ["-O3", "-march=native", "-std=c++17", *(f"-I{path}" for path in INCLUDE)]
    done = subprocess.run(["g++", *options, source, "-o", program, "-lceres", "-lglog"], capture_output=True, text=True)
    if done.returncode:
        raise PeerError(f"g++ failed: {' '.join(done.stderr.split())[:200]}")
    return program


def pose_vectors(rig: RigArrays) -> Array:
    """(C + N, 6): rotation vectors and translations of the cameras, then of the boards."""
    T = np.concatenate([rig.T_camera_world, rig.T_world_board])
    return np.concatenate([rotations.log(T[:, :3, :3]), T[:, :3, 3]], 1)


def poses_of(vectors: Array) -> Array:
    """(C + N, 4, 4): the inverse of `pose_vectors`, of any shape with as many numbers."""
    each = vectors.reshape(-1, 6)
    return transform(rotations.exp(each[:, :3]), each[:, 3:])
