"""How good a calibration is: errors per collection, as tables.

- ``table``: rows, columns and their averages, as CSV in ATOM's form;
- ``selection``, ``views``, ``pairing``: sensors and patterns by name, what they saw, and what is compared with what;
- ``rgb_to_rgb``: corners carried from one camera to another, in one collection or between two;
- ``single_rgb``: corners projected from the patterns' poses in the dataset;
- ``annotation``, ``range_to_rgb``: border points of LiDARs and depth cameras against the border in the image;
- ``range_to_range``: LiDARs and depth cameras against each other;
- ``truth``, ``ground_truth``: transforms against the true ones: without what no calibration can know; in ATOM's form;
- ``specification``: any of these tables by a text such as ``rgb-to-rgb:left:right``.
"""
