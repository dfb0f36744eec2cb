"""Patterns found in the data of cameras, LiDARs and depth cameras, real or simulated.

- ``detection``: images, and what every detector answers where it sees no pattern;
- ``corner_detector``: the detector of corners for a pattern: ``charuco``, ``chessboard`` or ``aprilgrid``;
- ``markers``, ``layouts``, ``tags``: the markers of a board, which of OpenCV's two layouts they speak for, and what is
  printed on an aprilgrid; ``board_corners``: from markers to corners;
- ``board_image``: where corners are, by the corners around them, and which of them do not fit;
- ``printed_corners``: where corners are exactly, and whether they look as printed;
- ``points``, ``depth``: the points of a LiDAR, and the pixels of a depth image, on a pattern and its border;
- ``board_plane``: the plane and the place of a board among measured points.
"""
