"""Checks of ROS packages (ROS 1 and ROS 2), read as text: nothing of the repository is run.

- ``tree``: the tracked files;
- ``cmake``, ``setup_script``, ``package``: what a package declares, builds and installs;
- ``python_code``, ``cpp_code``: what its code includes, imports and calls;
- ``faults``: the rules, with category and severity;
- ``check``: all checks; ``__main__``: their process.
"""
