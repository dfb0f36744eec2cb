"""Next poses: which further views would decide an undecided limit soonest, and what they are expected to bring.

- ``knowledge``: the information that a calibration has on its parameters, what further views add to it, and the
  standard deviations that follow;
- ``goals``: the limits of sensors, joints and tasks, as standard deviations that decide them;
- ``advice``: `advice.next_poses`, the best of some candidate poses, how many a limit takes, and what no pose can mend.
"""
