"""Result of a calibration, and its covariance with all sources of error.

- ``result``, ``calibrated``: the result; ``projection``: errors over an image;
- ``fixed_inputs``, ``lens_errors``: fixed parameters that may be wrong, and how far they err; ``suspects``: those that
  do not fit the labels;
- ``clusters``, ``linear_model``: all parameters at the optimum; ``error_bars``: the total covariance, and that of a
  good robot with the same views.
"""
