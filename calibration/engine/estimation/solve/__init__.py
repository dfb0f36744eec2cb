"""Solution of a problem: normal equations and least squares, and what they determine.

- ``normal_equations``, ``least_squares``: the minimisation; ``optimisation``: with noise that matches the residuals;
- ``noise_levels``: standard deviations of the labels; ``options``: the options of a calibration;
- ``observability``: covariance, and directions that the data do not determine;
- ``label_columns``: derivatives of labels by fixed parameters; ``design``: choice of collections.
"""
