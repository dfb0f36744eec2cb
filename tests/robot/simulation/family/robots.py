"""ATOM's family of systems beside those that ship, each in a few lines."""

from tests.robot.simulation.family.describing import BOARD, CHESSBOARD, SMALL, UR10E, Robot

MOVED = {"p": ("world", BOARD)}
STANDING = {"p": ("world 1.6 0.4 1.4 -1.8 0 -1.4", BOARD)}
HAND = "flange 0.05 0.02 0.03 0.1 -1.4 0.05"
SLACK = {"position_bias": 0.02}

rrbot = Robot(
    "rrbot",
    sensors={"left": ("rgb", "world 0.015 0.18 1.66"), "right": ("rgb", "world 0.015 -0.18 1.66")},
    patterns=MOVED,
)
rdbot = Robot(
    "rdbot",
    sensors={"colour": ("rgb", "world 0.015 0.03 1.66"), "depth": ("depth", "world 0.015 -0.03 1.66")},
    patterns=MOVED,
    anchored="colour",
    motion={"distance_m": [1.2, 2.4]},
)
rrcbot = Robot("rrcbot", rrbot.sensors, patterns={"p": ("world", CHESSBOARD)})
rihbot = Robot("rihbot", {"hand": ("rgb", HAND)}, STANDING, frames=f"world base 0 0 0.8 \n {UR10E}")
mrbot = Robot(
    "mrbot",
    sensors={
        "c0": ("rgb", "world -2.0 0.0 1 0 0 0"),
        "c1": ("rgb", "world -0.62 -1.90 1 0 0 1.257"),
        "c2": ("rgb", "world 1.62 -1.18 1 0 0 2.513"),
        "c3": ("rgb", "world 1.62 1.18 1 0 0 3.770"),
        "c4": ("rgb", "world -0.62 1.90 1 0 0 5.027"),
    },
    patterns=MOVED,
    motion={"distance_m": [1.6, 2.4], "tilt_deg": 60},
)
mrjbot = Robot(
    "mrjbot",
    sensors={"hand": ("rgb", HAND)},
    patterns=STANDING,
    frames=f"world base prismatic 0 1 0 -0.3 0.3  0 0 0.8 \n {UR10E}",
    joints=dict.fromkeys(("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "flange"), SLACK),
    anchored="hand",
)
rihmpbot = Robot(
    "rihmpbot",
    sensors={"hand": ("rgb", HAND)},
    patterns={
        **STANDING,
        "q": ("world 1.5 -0.9 1.0 -1.8 0 -1.6", {**BOARD, "dictionary": "DICT_4X4_100"}),
        "r": ("world 1.2 0.9 0.9 -2.2 0 -1.2", {**SMALL, "dictionary": "DICT_6X6_100"}),
    },
    frames=rihbot.frames,
)
riwmpbot = Robot(
    "riwmpbot",
    sensors={"world": ("rgb", "world 1.7 0.2 1.5 0 0.2 3.0")},
    patterns={
        "on_flange": ("flange 0.06 -0.06 0.02", SMALL),
        "on_forearm": ("forearm -0.3 0.05 0.1 0 1.0 0", {**SMALL, "dictionary": "DICT_4X4_100"}),
        "on_upper_arm": ("upper_arm -0.3 0.05 0.25 0 1.2 0", {**SMALL, "dictionary": "DICT_6X6_100"}),
    },
    frames=rihbot.frames,
    joints=dict.fromkeys(("upper_arm", "forearm", "wrist_1", "wrist_2"), SLACK),
    motion={"distance_m": [0.6, 1.4], "roll_deg": 180},
)
FAMILY = (rrbot, rdbot, rrcbot, rihbot, mrbot, mrjbot, rihmpbot, riwmpbot)
