"""Checks of a calibration that need no ground truth: findings with their cause, size and effect on the sensors.

- ``finding``: the finding of a check; ``limits``: limits of the errors of a result;
- ``check_data`` and what it calls (``copies``, ``units``): data that are refused without a solution;
- ``diagnose``: all checks of a result, in the order of the report, and what each of them waits for;
- ``what_does_not_fit``: suspects (`covariance.suspects`) as findings; ``precision``: how sure the result is;
- ``projection``: calibrated intrinsics, by what they are worth in the image;
- ``description``, ``rejected_labels``, ``residuals``: the robot's description, labels and views that do not fit, and
  those that do;
- ``conventions``: other conventions by which a recording would fit, where it does not as it was read;
- ``after_move``: the calibration since something has moved;
- ``software_output``, ``against_optimum``: checks of the output of other software.
"""
