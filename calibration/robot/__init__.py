"""Robot and its recordings: what becomes a dataset, and what a calibration is written to.

It imports `calibration.base`, `calibration.engine` and, for tasks and reports, `calibration.ci`.

- ``robot_description``, ``xacro_expansion``, ``xacro_expressions``: files of URDF and xacro, read safely; ``urdf``: the
  robots that they describe; ``confinement``: of processes that read untrusted files;
- ``labelling``: patterns found in images, point clouds and depth images, real or simulated;
- ``exports``, ``calibrated_urdf``: a calibrated dataset as launch files, camera parameters, and in the given URDF;
- ``simulation``: robots, motions, what sensors would see, and datasets collected from it;
- ``next_pose``: poses that can be had next, and what to do to take them;
- ``importing``: recordings of a team (bags, images, poses, intrinsics of other tools) made a dataset.
"""
