"""Files of other tools.

- ``structured_files``: their formats; ``camera_files``, ``target_files``: intrinsics and patterns in them;
- ``pose_files``, ``pose_form``, ``samples``: what is a pose there, and how it is written;
- ``pictures``: the image files of each camera, and their association across cameras;
- ``confined_decoding``: decoding by a library in C or Rust, in a process that can do nothing else.
"""
