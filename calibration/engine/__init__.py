"""Engine: a dataset, its calibration, and whether to believe it.

It imports `calibration.base` only, and needs no package but numpy. From the bottom up:

- ``geometry``: rotations, transforms, cameras and lenses, trees of frames;
- ``dataset``: ATOM datasets and configurations: read, check, write;
- ``estimation``: the calibration, from labels to transforms with their covariances;
- ``evaluation``: tables of errors; ``comparison``: other methods on the same data;
- ``tasks``: how far off the robot is where it works; ``next_pose``: which further views would decide a limit;
- ``diagnosis``: checks of a calibration that need no ground truth;
- ``baseline``: an accepted calibration, and what has changed since.
"""
