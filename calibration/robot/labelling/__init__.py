"""Detection of patterns in the data of cameras, LiDARs and depth cameras, real or simulated.

- ``detection``: types of images and of detectors;
- ``corner_detector``: the corner detector of a pattern, in ``charuco``, ``aprilgrid``, ``tag_list`` or
  ``unmarked_grids``;
- ``markers``: the markers of a board; ``board_corners``: OpenCV's two layouts of a board, and from markers to corners;
- ``board_image``: prediction of corners from neighbouring corners, and outlier rejection;
- ``printed_corners``: sub-pixel refinement, and comparison with the print;
- ``points``, ``scan_line``, ``depth``: the points of a LiDAR or of a 2D one, and the pixels of a depth image, on a
  pattern and its border.
"""
