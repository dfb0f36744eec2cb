"""Estimation: from labels to transforms with their covariances. Numpy only.

A dataset's way: `calibrate.calibrate` is `solve(prepare(dataset, options), noise)`. `prepare` decides once what does
not depend on noise: the scale of measured poses and lags (`scale_and_lags`), the problem, its linear start, wrong
views, and the optimum from there (`at_optimum`). `solve` returns that optimum, or calibrates from a noisy start.
``options`` are those of a calibration.

The sub-rooms, in the order of the computation; each imports only those before it:

- ``residuals``: the chain of each view's pose, and the residuals of its labels with their Jacobians;
- ``problem``: the unknowns, which of them are fixed, and the labels that determine them;
- ``least_squares``: normal equations, their minimisation, levels of the noise, and what the data determine;
- ``start``: from a dataset to a problem with an initial guess; views that contradict the others;
- ``covariance``: the result with all sources of its error, and fixed parameters that do not fit.
"""
