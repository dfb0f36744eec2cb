"""Sensors that move, held against a witness: the motion of an arm or a base, or another sensor.

- ``bundle``: scene points and poses by least squares, and what the images alone say of each pose;
- ``displacement``: the test of the accepted mount against a free one, and the moment from which on it moved;
- ``checks``: cameras, by the motion that carries them and by each other; ``depth_edges``: by a LiDAR beside them;
- ``plane_map``: LiDARs, by the map that their scans make;
- ``recorded_frames``: where the link of a sensor was, over a recording; ``moving_frames``: the cameras of a bag.
"""
