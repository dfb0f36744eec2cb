"""Residuals of views, and their Jacobians.

- ``views``: the chain of each view's pose, and what residuals of all kinds have in common;
- ``corner_residuals``, ``ray_residuals``, ``pose_residuals``: those of each kind of label;
- ``planar_pose``: the pose of a pattern from one view.
"""
