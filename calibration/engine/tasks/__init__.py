"""Robot tasks: how far off a robot is where it works, by the covariance of its calibration.

- ``robot_task``: what a robot does with its calibration, as calibration.yml has it, and its poses there;
- ``placed_task``: its points at a calibration;
- ``task_errors``: its error at every point, split by what it comes from, and against a known world.
"""
