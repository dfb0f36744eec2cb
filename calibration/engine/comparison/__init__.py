"""Other calibration methods on the same dataset, to compare with the built-in engine.

``methods`` lists them; each takes a dataset and returns a new one with its own transforms:

- ``sensor_pairs``: two cameras by OpenCV, two LiDARs or depth cameras by ICP;
- ``arm``: cameras, an arm, fixed patterns; by OpenCV, or by ``hand_eye_solvers`` and the robot-world solutions of the
  estimation.
"""
