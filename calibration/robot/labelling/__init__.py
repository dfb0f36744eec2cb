"""Detection of patterns in the data of cameras, LiDARs and depth cameras, real or simulated.

- ``detection``: types of images and of detectors;
- ``corner_detector``: the corner detector of a pattern, in ``marked_boards``, ``unmarked_grids`` or ``markers``;
- ``markers``: the markers of a board, and single tags; ``board_corners``: OpenCV's two layouts of a board, and from
  markers to corners;
- ``board_image``: prediction of corners from neighbouring corners, sub-pixel refinement, comparison with the print;
- ``points``, ``scan_line``, ``depth``: the points of a LiDAR or of a 2D one, and the pixels of a depth image, on a
  pattern and its border.
"""
