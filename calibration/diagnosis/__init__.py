"""Checks of a calibration that need no ground truth: what is wrong, by how much, and what it does to the sensors.

- ``finding``: what a check has found; ``limits``: how far off a result may be;
- ``check_data`` and what it calls (``copies``, ``units``, ``board_order``): data that are refused unsolved;
- ``what_does_not_fit``: suspects (`calibration.estimation.suspects`) in words; ``too_few``: too few views to tell;
- ``precision``, ``description``, ``exchanged_labels``, ``mirrored``, ``wrong_views``, ``rejected_labels``,
  ``repeated``, ``residuals``: one each;
- ``diagnose``: all of them, in a reader's order;
- ``same_labels``, ``against_optimum``, ``table_follows``: what the team's own software has left.
"""
