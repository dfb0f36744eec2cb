"""Preview of a recording: what is in it, how good its images are, and what is missing for a calibration.

- ``images``: the cameras' images, whatever they are in, and a sample of them with the pattern;
- ``topics``: a bag's topics, frames and intrinsics; ``looking``: the whole, and what is missing;
- ``judging``: each image as it arrives, while a recording is made.
"""
