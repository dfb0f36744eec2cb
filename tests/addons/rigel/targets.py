"""Rigelfiles, fuzzed by `tests.campaigns`."""

from calibration.addons.rigel.conversion import convert
from calibration.addons.rigel.document import read_rigelfile
from tests.campaigns.target import Target, files_of

TARGETS = {
    "rigelfile": Target(
        "Rigelfile", files_of("tests/addons/rigel/rigelfiles/*.rigel"), lambda path: convert(read_rigelfile(path)), 2
    ),
}
"""By name."""
