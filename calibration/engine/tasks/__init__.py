"""Robot tasks: how far off a robot is where it works, by the covariance of its calibration.

- ``robot_task``: what a robot does with its calibration, as calibration.yml has it;
- ``work_poses``: poses of its own, by positions of the robot's joints;
- ``placed_task``: its points at a calibration, and `placed_task.task_jacobian`: the derivatives of its error by all
  parameters of the calibration, calibrated and held;
- ``gaussian_norm``: quantiles of the norm of a Gaussian error;
- ``task_errors``: `task_errors.task_errors`, its error at every point, split by what it comes from;
- ``carried_out``: its error against a known world.
"""
