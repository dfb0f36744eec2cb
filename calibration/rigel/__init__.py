"""Rigelfiles, read safely and written anew as ``calibration.yml``; what cannot be carried over is named.

    conversion = convert(read_rigelfile(Path("Rigelfile")))
    text = written(conversion, "Rigelfile")

Forms: 0.3.0 (``application``, ``jobs``, ``sequences`` with stages) and the older ones (``applications``,
sequences as lists, ``{{ name }}``); and requests of RoboMaker's ``CreateSimulationJob``. Nothing in a Rigelfile
is executed, no environment variable is read.
"""
