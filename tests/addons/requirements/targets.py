"""Bags and properties in HPL, fuzzed by `tests.campaigns`."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from calibration.addons.requirements.hpl import parse_property
from calibration.addons.requirements.judging import judge_bag
from calibration.addons.requirements.settings import RequirementSettings
from calibration.base.records import read
from tests.addons.requirements.messages import bag_file, battery, own_types, scan, twist
from tests.addons.requirements.truth_tables import ROWS
from tests.campaigns.target import Target
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind

SECTION = {
    "topics": {
        "/scan": {
            "within": "1s",
            "min-rate": 1,
            "max-gap": "1s",
            "max-latency": "1s",
            "fields": {"ranges": {"max": 3}},
        },
        "/battery": {"fields": {"cells.history": {"max": 3}, "name": {"equals": "main"}}},
    },
    "frames": {"laser": {"max-age": "1s"}},
    "hpl": [
        "globally: /cmd_vel as A causes /scan {ranges[0] > @A.linear.x} within 1 s",
        "globally: no /battery {state > OK}",
    ],
}


def _write(bag: BagFile) -> None:
    own_types(bag)
    for i in range(3):
        bag.write("/cmd_vel", BEGIN + i * SECOND, twist(bag, 0.5))
        bag.write("/scan", BEGIN + i * SECOND, scan(bag, BEGIN, [1.0, 2.0]))
        bag.write("/battery", BEGIN + i * SECOND, battery(bag, 1))


def _bag(kind: Kind) -> Callable[[], list[bytes]]:
    def made() -> list[bytes]:
        with tempfile.TemporaryDirectory() as folder:
            path = bag_file(Path(folder), kind, _write)
            return [(path if path.is_file() else next(path.glob(f"*.{kind}"))).read_bytes()]

    return made


def _judge(path: Path) -> object:
    return judge_bag(read(RequirementSettings, SECTION, "requirements"), [path], "requirements")


TARGETS = {
    **{f"messages.{kind}": Target(f"robot.{kind}", _bag(kind), _judge, 2) for kind in ("bag", "db3", "mcap")},
    "hpl": Target(
        "property.hpl",
        lambda: [hpl.encode() for hpl in dict.fromkeys(hpl for hpl, _, _ in ROWS)],
        lambda path: parse_property(path.read_bytes().decode("utf-8", "replace"), "hpl"),
        2,
    ),
}
"""By name."""
