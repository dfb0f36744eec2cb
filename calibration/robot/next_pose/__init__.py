"""Poses that can be had next with a robot or a board, and what a person or a player does to take them.

- ``expected_labels``: the labels that the sensors of a recording would have of a pattern elsewhere;
- ``candidates``: poses within the reach of what has moved in a recording, seen by its sensors;
- ``plan``: the poses of a recording before anything is recorded; a pose in words, as joint positions or transforms, and
  as a motion file.
"""
