"""Doubts about a calibration: what does not fit its labels.

- ``suspects``: fixed parameters that do not fit; ``lags``: those that can be calibrated;
- ``wrong_views``: views that contradict the majority; ``false_minima``: optima that are not the result.
"""
