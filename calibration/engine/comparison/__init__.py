"""Other calibration methods on the same dataset, to compare with the built-in engine.

``methods`` lists them; each takes a dataset and returns a new one with its own transforms:

- ``opencv_stereo``: two cameras;
- ``icp``: two LiDARs or depth cameras;
- ``arm_methods``: cameras, an arm, fixed patterns (``arm``), by OpenCV (``opencv_arm``) or by ``hand_eye_solvers``
  and the robot-world solutions of the estimation.
"""
