"""ATOM datasets: reading, checks and writing; calibration configuration; patterns; point clouds.

`calibration.dataset.reading.read_dataset` returns a `calibration.dataset.model.Dataset`.
"""
