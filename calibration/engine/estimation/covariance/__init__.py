"""Result of a calibration, and its covariance with all sources of error.

- ``result``, ``calibrated``: the result; ``label_errors``: residuals by label; ``projection``: errors over an image;
- ``fixed_inputs``, ``lens_errors``, ``nominal_lens``: fixed parameters that may be wrong, and how far they err;
- ``cluster_sums``, ``linear_model``: all parameters at the optimum; ``error_bars``: the total covariance;
  ``nominal_covariance``: that of a good robot with the same views; ``significance``: statistics as standard scores.
"""
