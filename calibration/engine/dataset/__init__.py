"""ATOM datasets: reading, checks and writing; calibration configuration; patterns; point clouds.

`calibration.engine.dataset.reading.read_dataset` returns a `calibration.engine.dataset.model.Dataset`.
"""
