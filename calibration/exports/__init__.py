"""A calibration in the forms that a robot takes: its description, launch files, camera parameters.

- ``calibrated``: what is exported, from a calibrated dataset;
- ``urdf``: the team's own URDF with the calibrated origins, every other byte as it was;
- ``transforms``: launch files of static transforms for ROS 1 and ROS 2, and the same as YAML;
- ``cameras``: camera_info, Kalibr's camchain, OpenCV's FileStorage;
- ``formats``: the table of all of them.
"""
