"""Preview of a recording: what is in it, how good its images are, and what is missing for a calibration.

- ``sources``: the cameras' images, whatever they are in; ``topics``: a bag's topics, frames and intrinsics;
- ``images``: a sample of a camera's images, and the pattern in them; ``looking``: the whole, and what is missing;
- ``report``: what it reports.
"""
