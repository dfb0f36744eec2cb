"""Bags of ROS 1 and ROS 2, read without ROS.

- ``unpacking``, ``bag``, ``messages``, ``range_views``, ``video_packets``: their messages as arrays;
- ``survey``: a first pass, without decoding images; ``motion_log``, ``recorded_lens``: motion and intrinsics in it;
- ``recordings``: the second pass; ``stillness``, ``best_moments``: moments at standstill, and the best of them;
- ``board_motion``: velocities of boards that a hand moves.
"""
