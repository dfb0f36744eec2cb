"""ATOM datasets: read, checked, written; the calibration configuration; patterns; point clouds.

`calibration.dataset.reading.read_dataset` gives a `calibration.dataset.model.Dataset`.
"""
