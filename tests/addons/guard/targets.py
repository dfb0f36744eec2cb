"""References of cameras, fuzzed by `tests.campaigns`."""

from calibration.addons.guard.reference import REFERENCE_FILE, Reference, read_reference
from tests.addons.guard.recorded import reference
from tests.campaigns.target import Target

TARGETS = {
    "reference": Target(REFERENCE_FILE, lambda: [Reference(1, (reference(),)).text.encode()], read_reference, 5),
}
"""By name."""
