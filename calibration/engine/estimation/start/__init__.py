"""Start of a calibration: from a dataset to a problem with an initial guess.

- ``build``: the problem of a dataset; ``guesses``, ``starting_noise``: the dataset's guess, with the matrix's noise;
  ``cost``: the cost of given transforms;
- ``single_views``, ``sights``, ``plane_alignment``, ``scan_alignment``, ``robot_world``, ``linear_start``: a guess from
  the labels alone; ``agreeing_rotations``, ``turned_boards``, ``flipped_patterns``: views with several readings;
- ``lens_choice``, ``chosen_lenses``: the lens models of cameras without intrinsics.
"""
