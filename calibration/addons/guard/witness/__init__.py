"""Sensors that move, held against a witness: the motion of an arm or a base, or another sensor.

- ``tracks``: points of the scene, found again from image to image;
- ``bundle``: scene points and poses by least squares, and what the images alone say of each pose;
- ``displacement``: the test of the accepted mount against a free one, and the moment from which on it moved;
- ``plane_map``: planes that scans of a LiDAR see again, and what they say of each pose;
- ``depth_edges``, ``edge_checks``: edges that a camera and a LiDAR both see, and what is said by them;
- ``recorded_frames``: where the link of a sensor was, over a recording;
- ``checks``: what is said of a sensor by it;
- ``moving_frames``, ``map_checks``: the cameras of a bag, by all of these, and its LiDARs by their map.
"""
