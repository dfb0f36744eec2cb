"""Calibration engine: from labels to transforms with their covariances.

`calibration.estimation.calibrate.calibrate` is the entry point. Numpy only.

The modules of the engine, in the order of the computation:

- ``blocks``: the unknowns and their parametrisations; ``views``: the chain of each view's pose; ``batches``: views
  that are evaluated in one pass; ``problem``: blocks and views together;
- ``usable_labels``, ``scan``, ``build``: from a dataset to such a problem;
- ``planar_pose``, ``single_views``, ``plane_alignment``, ``robot_world``, ``linear_start``: an initial guess
  from the labels alone; ``initial_values``: that of the dataset;
- ``wrong_views``: rejection of views that contradict the majority, before the minimisation;
- ``starting_noise``: the matrix's noisy initial guesses;
- ``residuals``, ``normal_equations``, ``least_squares``: the minimisation;
- ``design``: the collections that determine a calibration best;
- ``noise_levels``, ``optimisation``: standard deviations of the labels, and the weighted optimum;
- ``flipped_patterns``, ``false_minima``: patterns that are mirrored there, and other reasons why it is not the result;
- ``observability``: covariance, weak directions, and directions that the data do not determine;
- ``label_columns``, ``held``, ``linear_model``: fixed parameters that may be wrong, with the derivatives of the labels
  with respect to them;
- ``assumptions``, ``repeated``, ``error_bars``: assumed errors of fixed parameters, independent collections, and the
  total covariance of the result; ``nominal``: that of a good robot with the same views;
- ``suspects``, ``significance``: fixed parameters that do not fit the labels;
- ``lens_choice``, ``chosen_lenses``: the lens models of cameras without intrinsics; ``projection``: how sure the
  projection of calibrated ones is, over the image;
- ``calibrate``, ``calibrated``, ``result``: all of it.
"""
