"""Least squares of a problem: normal equations and their minimisation, and what they determine.

- ``normal_equations``, ``minimisation``: the minimisation, alone and with noise that matches the residuals;
- ``noise_levels``: standard deviations of the labels;
- ``observability``: covariance, directions that the data do not determine, and the choice of collections;
- ``label_columns``: derivatives of labels by fixed parameters.
"""
