"""How good a calibration is: errors per collection, as tables.

- ``table``: rows, columns and their averages, as CSV in ATOM's form;
- ``selection``, ``views``: sensors and patterns by name, and what they saw;
- ``rgb_to_rgb``: corners carried from one camera to another, in one collection or between two;
- ``annotation``, ``lidar_to_rgb``: a LiDAR's border points in the image, against the pattern's border;
- ``truth``: transforms against the true ones;
- ``specification``: any of these tables by a text such as ``rgb-to-rgb:left:right``.
"""
