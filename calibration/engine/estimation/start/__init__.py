"""Start of a calibration: from a dataset to a problem with an initial guess.

- ``build``: the problem of a dataset; ``guesses``: the dataset's guess, the matrix's noise, the cost of transforms;
- ``single_views``, ``linear_solvers``, ``linear_start``: a guess from the labels alone;
- ``ambiguous_views``: views with two readings; ``wrong_views``: those that contradict the rest;
- ``lens_choice``: the lens models of cameras without intrinsics.
"""
