"""The calibration engine: from labels to transforms with honest error bars.

`calibration.estimation.calibrate.calibrate` is the way in. Numpy only.

The rooms of the engine, in the order of the work:

- ``blocks``: what is unknown, and what its parameters do; ``views``: how the unknowns make up each view's pose
  (chains); ``batches``: views that are evaluated in one pass; ``problem``: all of it;
- ``usable_labels``, ``scan``, ``build``: a dataset as such a problem;
- ``planar_pose``, ``single_views``, ``plane_alignment``, ``robot_world``, ``linear_start``: a start
  that needs no guess;
- ``wrong_views``: views that contradict the majority of the others, left out before anything is minimised;
- ``starting_noise``: the matrix's noisy guesses;
- ``residuals``, ``normal_equations``, ``least_squares``: a minimum;
- ``design``: which collections determine a calibration best;
- ``noise_levels``, ``optimisation``: what a pixel and a metre weigh, and so the optimum;
- ``observability``: covariance, weak directions, what the data cannot determine;
- ``label_columns``, ``held``, ``linear_model``: what is held and could be wrong, with the columns by which it
  would change the labels, beside what is calibrated;
- ``assumptions``, ``repeated``, ``error_bars``: how well that is known, which collections are independent, and so
  how sure the result is in all;
- ``suspects``, ``significance``: which of it does not fit the labels;
- ``calibrate``, ``result``: all of it.
"""
