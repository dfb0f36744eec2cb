"""Baseline: accepted calibrations kept in git, and their comparison with new ones.

A `snapshot.Snapshot` is a calibration's result as comparable numbers; `document` reads and writes the reviewed file of
accepted ones, ``calibration-baseline.json``; `comparison` computes the differences, `verdict` judges them.
"""
