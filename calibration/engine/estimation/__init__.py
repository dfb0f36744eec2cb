"""Estimation: from labels to transforms with their covariances. Numpy only.

`calibration.engine.estimation.calibrate.calibrate` is the entry point. The sub-rooms, in the order of the computation;
each imports only those before it:

- ``residuals``: the chain of each view's pose, and the residuals of its labels with their Jacobians;
- ``problem``: the unknowns, which of them are fixed, and the labels that determine them;
- ``solve``: normal equations, least squares, levels of the noise, and what the data determine;
- ``start``: from a dataset to a problem with an initial guess;
- ``covariance``: the result with all sources of its error;
- ``doubts``: what does not fit: suspects, lags, wrong views, false minima.

- ``from_linear_start``, ``from_given_guess``, ``at_optimum``: the steps of a calibration; ``calibrate``: all of it.
"""
