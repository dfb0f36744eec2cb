"""mrcal on a rig, its intrinsics free or held: a script for the Python that has mrcal, usually the system's.

``python3 mrcal_script.py START.npz SOLUTION.npz``; it needs numpy and mrcal, and nothing of this project.
"""

import sys
import time

import mrcal
import numpy as np

COLUMNS, ROWS, SPACING = 10, 5, 0.06


def vectors(T: np.ndarray) -> np.ndarray:
    """Rotation vectors and translations (n, 6) of transforms (n, 4, 4)."""
    return mrcal.rt_from_Rt(np.concatenate([T[:, :3, :3], T[:, None, :3, 3]], 1))


def matrices(rt: np.ndarray) -> np.ndarray:
    """The inverse of `vectors`."""
    Rt, T = mrcal.Rt_from_rt(rt), np.tile(np.eye(4), (len(rt), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = Rt[:, :3], Rt[:, 3]
    return T


def main(start: str, solution: str) -> None:
    """Solve the rig in one file; write the poses, the intrinsics and the seconds to another."""
    rig = np.load(start)
    free = bool(rig["free_intrinsics"])
    C, N = len(rig["T_camera_world"]), len(rig["T_world_board"])
    labels = rig["pixels"].reshape(C, N, 2, ROWS, COLUMNS).transpose(1, 0, 3, 4, 2).reshape(N * C, ROWS, COLUMNS, 2)
    frame, camera = np.divmod(np.arange(N * C), C)
    extrinsics, frames = vectors(rig["T_camera_world"][1:]), vectors(rig["T_world_board"])
    intrinsics = np.tile(rig["intrinsics"], (C, 1))
    arguments = {
        "intrinsics": intrinsics,
        "extrinsics_rt_fromref": extrinsics,
        "frames_rt_toref": frames,
        "points": None,
        "observations_board": np.concatenate([labels, np.ones((N * C, ROWS, COLUMNS, 1))], -1),
        "indices_frame_camintrinsics_camextrinsics": np.stack([frame, camera, camera - 1], -1).astype(np.int32),
        "observations_point": None,
        "indices_point_camintrinsics_camextrinsics": None,
        "lensmodel": "LENSMODEL_OPENCV5",
        "imagersizes": np.array([[1280, 960]] * C, np.int32),
        "do_optimize_intrinsics_core": free,
        "do_optimize_intrinsics_distortions": free,
        "do_optimize_calobject_warp": False,
        "calibration_object_spacing": SPACING,
        "do_apply_outlier_rejection": False,
        "do_apply_regularization": False,
    }
    begin = time.perf_counter()
    mrcal.optimize(**arguments)  # it overwrites intrinsics, extrinsics and frames
    seconds = time.perf_counter() - begin
    T_camera_world = np.concatenate([np.eye(4)[None], matrices(extrinsics)])
    found = {"T_camera_world": T_camera_world, "T_world_board": matrices(frames), "intrinsics": intrinsics}
    np.savez(solution, **found, seconds=seconds)


if __name__ == "__main__":
    main(*sys.argv[1:])
