"""ATOM's evaluations in the command of a container, so that our engine makes the same table beside it."""

import re
from collections.abc import Mapping

from calibration.rigel.notes import Notes

_SOURCE, _TARGET = ("-ss", "--sensor_source"), ("-st", "--sensor_target")
_RANGE, _DEPTH, _CAMERA = ("-rs", "--range_sensor"), ("-ds", "--depth_sensor"), ("-cs", "--camera_sensor")
_PATTERN = ("-pn", "--pattern_name")
_Flag = tuple[str, str]
_PAIRS: Mapping[str, tuple[_Flag, _Flag]] = {
    "rgb_to_rgb": (_SOURCE, _TARGET),
    "lidar_to_rgb": (_RANGE, _CAMERA),
    "depth_to_rgb": (_DEPTH, _CAMERA),
    "lidar_to_lidar": (_SOURCE, _TARGET),
    "lidar_to_depth": (_RANGE, _DEPTH),
    "depth_to_depth": (_SOURCE, _TARGET),
}
_BETWEEN = ("inter_collection_", "cross_collection_")
"""What stands before a pair's script whose table is between collections, and in earlier versions."""
_NEEDED: Mapping[str, tuple[_Flag, ...]] = {
    **_PAIRS,
    **{f"{before}{script}": flags for before in _BETWEEN for script, flags in _PAIRS.items()},
    "single_rgb": (),  # its filters are functions in Python: all cameras and patterns
    "ground_truth_transform": (("-p", "--parent"), ("-c", "--child")),
    "ground_truth_frame": (("-tf", "--target_frame"),),
}
_OPTIONAL: Mapping[str, tuple[_Flag, ...]] = {
    "single_rgb": (),
    "ground_truth_transform": (),
    "ground_truth_frame": (("-sf", "--source_frame"),),
}
_SCRIPT = re.compile(rf"\b(?P<script>{'|'.join(_NEEDED)})_evaluation(?:\.py)?(?![\w.-])(?P<flags>[^\n;&|]*)")
"""One of the scripts, and what follows it up to the end of its command."""


def evaluation_in(command: str, notes: Notes, where: str) -> str | None:
    """The first of ATOM's evaluations in a command, as ``evaluate`` has it; None where there is none.

    One whose flags do not say which sensors is noted.
    """
    found = _SCRIPT.search(command.replace("\\\n", " "))
    if found is None:
        return None
    script, flags = found["script"], found["flags"]
    names = [_value(flags, flag) for flag in _NEEDED[script]]
    if None in names:
        missing = _NEEDED[script][names.index(None)][1]
        notes.to_do(where, f"evaluate: {script}_evaluation has no {missing} that can be read: write the table")
        return None
    more = [_value(flags, flag) for flag in _OPTIONAL.get(script, (_PATTERN,))]
    kind = script.replace("cross_", "inter_").replace("_", "-")
    return ":".join((kind, *(name for name in (*names, *more) if name)))


def _value(flags: str, flag: _Flag) -> str | None:
    found = re.search(rf"(?<!\S)(?:{'|'.join(flag)})(?:\s+|=)[\"']?(\w[\w.-]*)(?=[\"'\s)]|$)", flags)
    return found[1] if found else None
