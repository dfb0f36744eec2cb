"""Checks of a calibration that need no ground truth: findings with their cause, size and effect on the sensors.

- ``finding``: the finding of a check; ``limits``: limits of the errors of a result;
- ``check_data`` and what it calls (``copies``, ``units``, ``board_order``): data that are refused without a solution;
- ``what_does_not_fit``: suspects (`doubts.suspects`) as findings; ``too_few``: too few views;
- ``projection``: calibrated intrinsics, by what they are worth in the image;
- ``precision``, ``description``, ``turned_boards``, ``wrong_views``, ``rejected_labels``, ``repeated``, ``residuals``:
  one check each;
- ``conventions``: other conventions by which a recording would fit, where it does not as it was read;
- ``diagnose``: all of them, in the order of the report;
- ``same_labels``, ``against_optimum``, ``table_follows``: checks of the output of other software.
"""
