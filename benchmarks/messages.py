"""Requirements over messages: a bag of 1 GB with 20 of them, and HPL's state machines against the naive evaluator."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from benchmarks.rows import Bar, Row
from tests.addons.requirements import test_patterns
from tests.addons.requirements.messages import bag_file, scan, twist
from tests.addons.requirements.naive import Sent, Spec, naive_status
from tests.addons.requirements.traces import judged, parsed_trace
from tests.addons.requirements.truth_tables import ROWS
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind

IMAGES_IN_GIGABYTE = 520
"""At 10 Hz, each with a cloud of the same size: 52 s of a robot."""
TRACES_OF_PROPERTY = 10
WATCHED = """
import json, resource, sys, time
from pathlib import Path
from calibration.addons.requirements.check_messages import judged
from calibration.addons.requirements.settings import RequirementSettings
from calibration.base.records import read
settings = read(RequirementSettings, json.loads(sys.argv[2]), "requirements")
begin = time.perf_counter()
report = judged(settings, [Path(sys.argv[1])], Path("calibration.yml"))
usage = resource.getrusage(resource.RUSAGE_SELF)
found = [time.perf_counter() - begin, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, len(report.reasons)]
print(json.dumps([*found, len(report.results.requirements)]))
"""
"""Prints wall and CPU time, s, the most memory, MB, and how many requirements are not met, of how many."""
SECTION = {
    "topics": {
        "/camera": {"within": "1s", "min-rate": 9, "max-gap": "200ms", "max-latency": "20ms"},
        "/cloud": {"within": "1s", "min-rate": 9, "max-gap": "200ms"},
        "/scan": {"max-rate": 41, "max-gap": "50ms", "fields": {"ranges": {"min": 0.1, "max": 30}}},
        "/imu": {"min-rate": 390, "max-gap": "10ms", "fields": {"linear_acceleration.z": {"min": 0, "max": 20}}},
        "/cmd_vel": {"fields": {"linear.x": {"min": -1, "max": 1}}},
    },
    "frames": {"base": {"to": "odom", "within": "1s", "max-age": "100ms"}, "laser": {"to": "odom", "within": "1s"}},
    "hpl": [
        "globally: no /cmd_vel {abs(linear.x) > 1}",
        "globally: /cmd_vel causes /scan within 100 ms",
        "globally: /camera requires /imu within 100 ms",
        "globally: no /imu {linear_acceleration.z < 0}",
    ],
}


def measure(quick: bool) -> Iterator[Row]:
    """A bag of each kind, then tables and random traces."""
    with TemporaryDirectory() as folder:
        for kind in ("bag", "mcap") if not quick else ("bag",):
            yield from _judged(Path(folder), kind, IMAGES_IN_GIGABYTE // (10 if quick else 1))
    right = sum(
        test_patterns.STATUS_OF_SIGN[sign] == judged(hpl, *parsed_trace(trace)).status for hpl, trace, sign in ROWS
    )
    yield Row("messages/truth tables", right, "rows", Bar(low=len(ROWS)), f"right of {len(ROWS)}, which a hand judged")
    yield _equal(1000 if quick else 10_000)


def _judged(folder: Path, kind: Kind, images: int) -> Iterator[Row]:
    path = bag_file(folder, kind, lambda bag: _record(bag, images))
    files = [path] if path.is_file() else list(path.iterdir())
    size = sum(file.stat().st_size for file in files) / 1e9
    command = [sys.executable, "-c", WATCHED, str(path), json.dumps(SECTION)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    wall, cpu, memory, wrong, count = json.loads(done.stdout)
    note = f"a .{kind} of {size:.2f} GB, {count} requirements, {wrong} not met; CPU time, {wall:.1f} s on the clock"
    yield Row(f"messages/time, {kind}", cpu, "s", Bar(high=20), note)
    yield Row(f"messages/memory, {kind}", memory, "MB", Bar(high=300), "the most of the whole process")
    for file in files:
        file.unlink()


def _record(bag: BagFile, images: int) -> None:
    """Images of 0.92 MB and clouds of 1 MB at 10 Hz, scans at 40, an IMU at 400, tf at 100, commands at 20 Hz."""
    image = np.zeros((480, 640, 3), np.uint8)
    points = np.zeros((36_000, 3))
    bag.transforms("/tf_static", BEGIN, {("base", "laser"): np.eye(4)})
    zero = bag.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    gravity = bag.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=9.81)
    still = bag.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    unknown = {f"{name}_covariance": np.zeros(9) for name in ("orientation", "angular_velocity", "linear_acceleration")}
    for tick in range(40 * images):
        stamp = BEGIN + tick * SECOND // 400
        header = bag.header("base", stamp)
        values = {"orientation": still, "angular_velocity": zero, "linear_acceleration": gravity}
        bag.write("/imu", stamp, bag.make("sensor_msgs/msg/Imu", header=header, **values, **unknown))
        if tick % 4 == 0:
            bag.transforms("/tf", stamp, {("odom", "base"): np.eye(4)})
        if tick % 10 == 0:
            bag.write("/scan", stamp, scan(bag, stamp, [1.0] * 1440))
        if tick % 20 == 0 and tick < 40 * images - 40:
            bag.write("/cmd_vel", stamp, twist(bag, 0.5))
        if tick % 40 == 0:
            bag.image("/camera", stamp, image, "camera")
            bag.cloud("/cloud", stamp, points, "laser")


def _equal(count: int) -> Row:
    """Random properties, each over random traces."""
    begin = time.perf_counter()
    different: list[str] = []

    @settings(
        max_examples=count // TRACES_OF_PROPERTY, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @seed(1)
    @given(spec=test_patterns.specs(), number=st.integers(0, 2**32))
    def check(spec: Spec, number: int) -> None:
        random = Random(number)
        for _ in range(TRACES_OF_PROPERTY):
            sent, end = _random_trace(random)
            found = judged(spec.text(), [(each.time, each.topic, each.x) for each in sent], end)
            if found.status != naive_status(spec, sent, end):
                different.append(f"{spec.text()}: {sent}, {end}")

    check()
    seconds = time.perf_counter() - begin
    note = f"equal to the naive evaluator, of {count // TRACES_OF_PROPERTY} properties, {seconds:.0f} s"
    return Row(
        "messages/random traces", count - len(different), "traces", Bar(low=count), "; ".join(different[:1]) or note
    )


def _random_trace(random: Random) -> tuple[list[Sent], int]:
    """Messages of four topics, and when the bag ends, s."""
    sent, moment = [], 0
    for _ in range(random.randint(0, 15)):
        moment += random.randint(0, 2)
        sent.append(Sent(moment, random.choice("abpq"), random.randint(0, 2)))
    return sent, moment + random.randint(0, 3)
