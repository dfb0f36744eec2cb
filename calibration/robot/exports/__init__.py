"""Export of calibrated datasets to the file formats that robots use: URDF, launch files, camera parameters.

- ``calibrated``: the part of a calibrated dataset that is exported;
- ``urdf``: the given URDF with calibrated origins, all other bytes unchanged;
- ``transforms``: launch files of static transforms for ROS 1 and ROS 2, and the same as YAML;
- ``cameras``: camera_info, Kalibr's camchain, OpenCV's FileStorage;
- ``formats``: the table of all formats.
"""
