"""The guard: whether a sensor has moved since its calibration was accepted, by an ordinary recording without a board.

- ``outcome``: what a recording says of one sensor, the same for every method;
- ``recording``: images of bags, videos and folders, a bounded number of each camera's;
- ``features``, ``keeping``: what a fixed camera saw when it was accepted, kept beside the baseline;
- ``fixed_camera``, ``fixed_check``: a fixed camera against it, image by image, and over the recording;
- ``witness``: sensors that move, by what carries them and by each other;
- ``lerobot_episodes``, ``lerobot_check``: the same of datasets of robot learning;
- ``guarded``: what is checked, and the methods; ``check``: the command and its results.
"""

from calibration.base.addons import Addon, LazyCommand, SchemaFile

ADDON = Addon(
    commands={"check": LazyCommand(f"{__name__}.check:command", "Check by a recording whether a sensor has moved.")},
    keeps={
        "reference": LazyCommand(
            f"{__name__}.keeping:kept_references",
            "Recording in which the cameras stand still, to be compared with by check; SENSOR=PATH for one of several.",
        )
    },
    schemas={"check": SchemaFile(__name__, "results.schema.json", "check:CheckedRecording", "check")},
)
