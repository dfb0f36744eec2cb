"""Errors of a calibration per collection, as tables.

- ``table``: rows, columns and their averages, as CSV in ATOM's form;
- ``views``: sensors and patterns by name, their views, and the pairs of views to compare;
- ``two_sensors``: corners transferred from one camera to another, in one collection or between two; border points of
  LiDARs and depth cameras against the border in the image; LiDARs and depth cameras against each other;
- ``label_errors``: corners and measured poses against the patterns' poses in the dataset;
- ``truth``: ground truth, and errors against it: up to the gauge of the calibration, or in ATOM's form;
- ``specification``: any of these tables from a text such as ``rgb-to-rgb:left:right``.
"""
