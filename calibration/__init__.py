"""Calibration CI: does the robot still calibrate?

The rooms, from the bottom up (imports only point downwards): ``geometry``, ``dataset``,
``estimation``, ``evaluation``, ``comparison``, ``simulation``; beside them, knowing nothing of
calibration, ``introspection`` and ``workflow``; on top ``pipeline`` and ``commands``.

Nothing is imported here, so that a command pays only for what it uses.
"""

__version__ = "0.1.0"
