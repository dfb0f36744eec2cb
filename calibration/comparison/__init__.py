"""Other calibration methods on the same dataset, for rows beside the built-in engine's.

``methods`` names them; each takes a dataset and gives a new one with its own transforms:
``opencv_stereo`` (two cameras), ``icp`` (two LiDARs or depth cameras), ``robot_world_methods`` and
``hand_eye_methods`` (a camera, an arm, a fixed pattern).
"""
