"""Checks of ROS packages (ROS 1 and ROS 2), read as text: nothing of the repository is run.

- ``tree``: the tracked files; ``repository``: what is in them, each read once;
- ``package``, ``cmake``, ``uses``: what a package declares, builds, installs and uses;
- ``launch``, ``launch_python``: what launch files start; ``client_code``: what code publishes, serves and sets;
- ``graph``: the nodes and what connects them;
- ``faults``: the rules; ``..._checks``: their checks; ``__main__``: all of them, in a process of their own.
"""
