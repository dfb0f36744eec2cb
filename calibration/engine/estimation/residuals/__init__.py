"""Residuals of views, and their Jacobians.

- ``views``: the chain of each view's pose; ``residuals``: what residuals of all kinds have in common;
- ``corner_residuals``, ``ray_residuals``, ``pose_residuals``: those of each kind of label;
- ``border_rays``: the border of a pattern in rings and in depth images;
- ``planar_pose``: the pose of a pattern from one view; ``median``, ``one_thread``: arithmetic.
"""
