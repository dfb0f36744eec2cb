"""Baseline: accepted calibrations kept in git, and their comparison with new ones.

A `calibration_document.CalibrationDocument` is a result as comparable numbers; `document` reads and writes the file of
accepted ones, ``calibration-baseline.json``; `comparison` computes the differences, `verdict` judges them.
"""
