"""Bundles and what is in use, fuzzed by `tests.campaigns`."""

import json
from pathlib import Path

from calibration.addons.delivery.checking import check_bundle
from calibration.addons.delivery.destinations import FetchedBundle
from calibration.addons.delivery.in_use import read_in_use
from calibration.base import InputError
from tests.addons.delivery.bundles import LEFT, RIGHT, SYSTEM, URDF, camera_info, messages
from tests.addons.delivery.changed import EXPECTED, GOOD
from tests.campaigns.target import Target

LAUNCH = 'x = [Node(arguments=["0.1", "-0.2", "0.3", "0", "0", "0.6", "0.8", "base", "right"])]\n'
LAUNCH_OF_OPTIONS = 'x = [["--x", "1", "--qw", "1", "--frame-id", "base", "--child-frame-id", "right"]]\n'
LAUNCH_XML = '<launch><node exec="static_transform_publisher" args="0 0 0 0 0 0 1 base right"/></launch>'


def _is_good_envelope(line: bytes) -> bool:
    try:
        return bool(json.loads(line) == json.loads(GOOD.attestation or b""))
    except ValueError:
        return False


def _check(fetched: FetchedBundle) -> None:
    checked = check_bundle(fetched, EXPECTED)
    if checked.reasons:
        raise InputError(checked.reasons[0])
    assert fetched.content == GOOD.content, "a changed bundle is accepted"
    lines = (fetched.attestation or b"").splitlines()
    assert any(map(_is_good_envelope, lines)), "a changed attestation is accepted"  # any of several must hold


TARGETS = {
    "bundle": Target(
        "robot.calibration.tar",
        lambda: [GOOD.content],
        lambda path: _check(FetchedBundle("b", path.read_bytes(), GOOD.attestation)),
        4,
    ),
    "attestation": Target(
        "robot.intoto.jsonl",
        lambda: [GOOD.attestation or b""],
        lambda path: _check(FetchedBundle("b", GOOD.content, path.read_bytes())),
        4,
    ),
    "in-use.urdf": Target(
        "robot.urdf", lambda: [URDF.format(rpy="0 0 1").encode(), LAUNCH_XML.encode()], read_in_use, 4
    ),
    "in-use.py": Target("a.launch.py", lambda: [LAUNCH.encode(), LAUNCH_OF_OPTIONS.encode()], read_in_use, 4),
    "in-use.yaml": Target(
        "live.yaml",
        lambda: [json.dumps(each).encode() for each in (messages(LEFT, RIGHT), camera_info(SYSTEM.cameras[0]))],
        lambda path: read_in_use(Path(path)),
        4,
    ),
}
"""By name."""
