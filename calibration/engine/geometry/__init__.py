"""Rigid motions, cameras and trees of frames, on plain numpy arrays with leading batch axes.

Conventions, for the whole project:

- ``T_parent_child`` is a 4x4 homogeneous transform that maps child coordinates to parent
  coordinates, so that in ``T_world_camera @ T_camera_board`` adjacent frames match.
- A twist is ``(translation, rotation)``, 6 numbers in metres and radians. Perturbations are applied on
  the right, in the child frame: see `calibration.engine.geometry.transforms.retract`.
- Quaternions are ``[x, y, z, w]``. Angles are radians, lengths metres, image coordinates pixels;
  (0, 0) is the centre of the top-left pixel.
"""
