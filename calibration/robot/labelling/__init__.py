"""Detection of patterns in the data of cameras, LiDARs and depth cameras, real or simulated.

- ``detection``: types of images and of detectors;
- ``corner_detector``: the corner detector for a pattern: ``charuco``, ``chessboard`` or ``aprilgrid``;
- ``markers``, ``layouts``, ``tags``: the markers of a board, OpenCV's two layouts of a board, and the print of an
  aprilgrid; ``board_corners``: from markers to corners;
- ``board_image``: prediction of corners from neighbouring corners, and outlier rejection;
- ``printed_corners``: sub-pixel refinement, and comparison with the print;
- ``points``, ``depth``: the points of a LiDAR, and the pixels of a depth image, on a pattern and its border;
- ``board_plane``: the plane and the pose of a board among measured points.
"""
