"""Bags of ROS 1 and ROS 2, read without ROS.

- ``bag``, ``messages``, ``range_views``, ``video_packets``: their messages as arrays;
- ``survey``: a first pass, without decoding images; ``motion``: frames, joints and boards in motion;
- ``recordings``: the second pass; ``stillness``: moments at standstill.
"""
