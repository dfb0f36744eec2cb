"""Preview of a recording: what is in it, how good its images are, and what is missing for a calibration.

- ``sources``: the cameras' images, whatever they are in; ``topics``: a bag's topics, frames and intrinsics;
- ``patterns``: the pattern to look for, described or found; ``images``: a sample of a camera's images, measured;
- ``missing``: what a calibration lacks; ``looking``: the whole; ``results``, ``report``: what it reports.
"""
