"""Unknowns of a calibration: their parametrisation, which are fixed, and the views that they change.

- ``motion``, ``blocks``, ``intrinsics``: the unknowns and their parametrisations; ``unknown_intrinsics``,
  ``intrinsics_file``: intrinsics that are calibrated, and those of another run;
- ``batches``: views that are evaluated in one pass; ``problem``: blocks and views together;
- ``gauge``, ``fixing``: unknowns that are fixed, by the gauge or by the user; ``assumptions``: assumed errors of these;
- ``usable_labels``, ``repeated_collections``: the labels that count.
"""
