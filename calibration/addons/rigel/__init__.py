"""Conversion of Rigelfiles to ``calibration.yml``; everything that cannot be converted is reported.

    conversion = convert(read_rigelfile(Path("Rigelfile")))
    text = written(conversion, "Rigelfile")

Formats: 0.3.0 (``application``, ``jobs``, ``sequences`` with stages), the older ones (``applications``,
sequences as lists, ``{{ name }}``), and requests of RoboMaker's ``CreateSimulationJob``. Nothing in a Rigelfile
is executed, and no environment variable is read.
"""

from calibration.base.addons import Addon, LazyCommand

ADDON = Addon(
    commands={
        "import-rigelfile": LazyCommand(f"{__name__}.conversion:command", "Convert a Rigelfile to calibration.yml.")
    }
)
