"""Export of calibrated datasets to the file formats that robots use: URDF, launch files, camera parameters.

- ``calibrated``: the part of a calibrated dataset that is exported;
- ``urdf``: the given URDF with calibrated origins, all other bytes unchanged;
- ``formats``: launch files of static transforms for ROS 1 and ROS 2, the same as YAML, camera_info, Kalibr's camchain
  and OpenCV's FileStorage, and the table of them all.
"""
