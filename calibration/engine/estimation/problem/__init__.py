"""Unknowns of a calibration: their parametrisation, which are fixed, and the views that they change.

- ``blocks``: the unknowns and their parametrisations; ``intrinsics``: those of cameras, and their file;
- ``problem``: blocks and views together, evaluated in batches;
- ``fixing``: unknowns that are fixed, by the user or by the gauge.
"""
