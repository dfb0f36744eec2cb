"""Errors of a calibration per collection, as tables.

- ``table``: rows, columns and their averages, as CSV in ATOM's form;
- ``views``: sensors and patterns by name, their views, and the pairs of views to compare;
- ``rgb_to_rgb``: corners transferred from one camera to another, in one collection or between two;
- ``label_errors``: corners and measured poses against the patterns' poses in the dataset;
- ``range_to_rgb``: border points of LiDARs and depth cameras against the border in the image;
- ``range_to_range``: LiDARs and depth cameras against each other;
- ``truth``: errors against true transforms: up to the gauge of the calibration, or in ATOM's form;
- ``specification``: any of these tables from a text such as ``rgb-to-rgb:left:right``.
"""
