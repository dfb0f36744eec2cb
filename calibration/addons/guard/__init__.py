"""The guard: whether a sensor has moved since its calibration was accepted, by an ordinary recording without a board.

- ``outcome``: what a recording says of one sensor, the same for every method;
- ``recording``: images of bags, videos and folders, a bounded number of each camera's;
- ``features``: what a fixed camera saw when it was accepted, kept beside the baseline;
- ``fixed_camera``: a fixed camera against it, image by image; ``fixed_check``: over a recording, and what is kept;
- ``witness``: sensors that move, by what carries them and by each other;
- ``lerobot_episodes``, ``lerobot_check``: the same of datasets of robot learning;
- ``check``: the command, what it checks by which methods, and its results.
"""

from calibration.base.addons import Addon, LazyCommand, SchemaFile

ADDON = Addon(
    commands={"check": LazyCommand(f"{__name__}.check:command", "Check by a recording whether a sensor has moved.")},
    keeps={
        "reference": LazyCommand(
            f"{__name__}.fixed_check:kept_references",
            "Recording in which the cameras stand still, to be compared with by check; SENSOR=PATH for one of several.",
        )
    },
    schemas={"check": SchemaFile(__name__, "results.schema.json", "check:CheckedRecording", "check")},
)
