"""Motions that are uploaded to the recorder, fuzzed by `tests.campaigns`."""

from calibration.addons.recorder.page import parsed
from tests.campaigns.target import Target, files_of

TARGETS = {
    "motion-upload": Target(
        "motion.json", files_of("datasets/t2rgb/motion.json"), lambda path: parsed("m\n.json", path.read_bytes()), 4
    ),
}
"""By name."""
