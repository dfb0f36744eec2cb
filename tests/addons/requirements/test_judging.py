"""Requirements over bags of a robot that drives: each kind met and not met, with stamps and values."""

from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from tests.addons.requirements.messages import MS, bag_file, battery, drive, judge, own_types, scan, twist
from tests.robot.importing.bags import BEGIN, SECOND, BagFile, Kind


@pytest.fixture(scope="module", params=["bag", "db3", "mcap"])
def driven(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bag_file(tmp_path_factory.mktemp("bags"), request.param, drive)


@pytest.fixture(scope="module")
def ros1(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bag_file(tmp_path_factory.mktemp("bags"), "bag", drive)


GOOD: dict[str, object] = {
    "topics": {
        "/scan": {
            "within": "1.1s",
            "type": "sensor_msgs/LaserScan",
            "min-rate": 9.9,
            "max-rate": 10.1,
            "max-gap": "150ms",
            "max-latency": "20ms",
            "fields": {"ranges": {"min": 0.5, "max": 2}, "header.frame_id": {"equals": "laser"}},
        },
        "/cmd_vel": {"max-gap": "200ms", "fields": {"linear.x": {"min": 0, "max": 1}, "linear.y": {"equals": 0}}},
    },
    "frames": {"laser": {"to": "odom", "within": "1s", "max-age": "150ms"}, "odom": {"within": "1s"}},
    "hpl": [
        "globally: no /cmd_vel {linear.x > 1}",
        "globally: /cmd_vel causes /scan within 2 s",
        "globally: no /scan {exists i in ranges: ranges[@i] < 0.1}",
        "after /scan: some /cmd_vel {linear.x > 0.8}",
    ],
}


def test_what_holds_is_met(driven: Path) -> None:
    assert {name for name, each in judge(driven, **GOOD).items() if each.status != "met"} == set()


@pytest.mark.parametrize(
    ("limits", "name", "found", "after"),
    [
        ({"within": "1s"}, "first message", "1.020 s", [1.02]),
        ({"type": "sensor_msgs/PointCloud2"}, "type", "sensor_msgs/msg/LaserScan", []),
        ({"min-rate": 11}, "rate", "10 Hz", [1.02, 10.02]),
        ({"max-rate": 9}, "rate", "10 Hz", [1.02, 10.02]),
        ({"max-gap": "99ms"}, "gap", "100 ms", [1.02, 1.12]),
        ({"max-latency": "19ms"}, "latency", "20 ms", [1.02]),
        ({"fields": {"ranges": {"max": 1.9}}}, "ranges", "2", [1.02]),
        ({"fields": {"header.frame_id": {"equals": "lidar"}}}, "header.frame_id", "'laser'", [1.02]),
        ({"fields": {"header.stamp.sec": {"equals": 0}}}, "header.stamp.sec", "1700000001", [1.02]),
    ],
)
def test_what_a_topic_does_not_meet_says_the_value_and_when(
    ros1: Path, limits: dict[str, object], name: str, found: str, after: list[float]
) -> None:
    [judgement] = judge(ros1, topics={"/scan": limits}).values()
    assert (judgement.status, judgement.name) == ("not met", f"/scan: {name}")
    assert found in judgement.found
    assert [round(each.after, 3) for each in judgement.witnesses] == after


@pytest.mark.parametrize("limits", [{"within": "5s"}, {"max-gap": "1s"}, {"min-rate": 1}, {"max-latency": "1s"}])
def test_a_topic_that_is_not_there_is_not_met(ros1: Path, limits: dict[str, object]) -> None:
    [judgement] = judge(ros1, topics={"/camera": limits}).values()
    assert judgement.status == "not met"


def test_a_topic_that_falls_silent_before_the_end_has_a_gap(tmp_path: Path) -> None:
    def write(bag: BagFile) -> None:
        for i in range(20):
            bag.write("/cmd_vel", BEGIN + i * SECOND, twist(bag, 0))
            if i < 10:
                bag.write("/scan", BEGIN + i * SECOND, scan(bag, BEGIN + i * SECOND, [1]))

    found = judge(bag_file(tmp_path, "bag", write), topics={"/scan": {"max-gap": "2s", "min-rate": 1}})
    assert (found["/scan: gap"].status, found["/scan: rate"].status) == ("not met", "met")
    assert "10 s from the last one" in found["/scan: gap"].found


@pytest.mark.parametrize(
    ("frame", "limits", "found"),
    [
        ("laser", {"to": "map", "within": "5s"}, "unknown"),
        ("gripper", {"within": "5s"}, "known are base, laser, odom"),
        ("laser", {"to": "odom", "max-age": "90ms"}, "base 100 ms old"),
    ],
)
def test_a_frame_that_is_unknown_or_stale_is_not_met(
    ros1: Path, frame: str, limits: dict[str, object], found: str
) -> None:
    [judgement] = judge(ros1, frames={frame: limits}).values()
    assert judgement.status == "not met"
    assert found in judgement.found


def test_frames_in_a_circle_are_unknown(tmp_path: Path) -> None:
    def write(bag: BagFile) -> None:
        bag.transforms("/tf", BEGIN, {("a", "b"): np.eye(4), ("b", "a"): np.eye(4)})

    path = bag_file(tmp_path, "bag", write)
    assert judge(path, frames={"a": {"within": "1s"}})["frame a"].status == "not met"


def test_types_of_the_teams_own_are_judged(tmp_path: Path) -> None:
    path = bag_file(tmp_path, "mcap", drive)
    found = judge(
        path,
        topics={"/battery": {"fields": {"cells.charge": {"min": 0.6}, "name": {"equals": "main"}}}},
        hpl=["globally: no /battery {state != OK}", "globally: some /battery {cells[1].charge < 0.51}"],
    )
    assert [each.status for each in found.values()] == ["not met", "met", "met", "met"]
    assert found["/battery: cells.charge"].found == "0.55"


def nodes(bag: BagFile) -> None:
    text = {"level": 2, "msg": "ready", "file": "", "function": "", "line": 0}
    if bag.ros1:
        kind, more = "rosgraph_msgs/msg/Log", {"header": bag.header("", BEGIN), "name": "/ns/mover", "topics": []}
    else:
        stamp = bag.make("builtin_interfaces/msg/Time", sec=0, nanosec=0)
        kind, more = "rcl_interfaces/msg/Log", {"stamp": stamp, "name": "ns.mover"}
    constants = {name: value for name, _, value in bag.types.fielddefs[kind][0]}
    bag.write("/rosout", BEGIN, bag.make(kind, **text, **more, **{k: v for k, v in constants.items() if k.isupper()}))


@pytest.mark.parametrize("kind", ["bag", "db3"])
def test_nodes_are_seen_in_rosout(kind: Kind, tmp_path: Path) -> None:
    found = judge(bag_file(tmp_path, kind, nodes), nodes=["/ns/mover", "/planner"])
    assert [each.status for each in found.values()] == ["met", "not met"]


def test_nodes_are_seen_in_the_headers_of_connections(tmp_path: Path) -> None:
    path = tmp_path / "robot.bag"
    with BagFile(path, "bag") as bag:
        bag._topics["/cmd_vel"] = bag.writer.add_connection(
            "/cmd_vel", "geometry_msgs/msg/Twist", typestore=bag.types, callerid="/teleop"
        )
        bag.write("/cmd_vel", BEGIN, twist(bag, 0))
    assert judge(path, nodes=["teleop"])["node teleop"].status == "met"


def test_services_of_ros1_are_refused_and_of_ros2_events_are_looked_for(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="services"):
        judge(bag_file(tmp_path, "bag", drive), services=["/reset"])

    def write(bag: BagFile) -> None:
        bag.text("/reset/_service_event", BEGIN, "called")

    found = judge(bag_file(tmp_path, "db3", write), services=["/reset", "/stop"])
    assert [each.status for each in found.values()] == ["met", "not met"]


@pytest.mark.parametrize(
    ("hpl", "status", "found"),
    [
        ("globally: no /scam", "vacuous", "no topic /scam in the bag"),
        ("globally: no /scam", "vacuous", "did you mean '/scan'"),
        ("globally: some /scam", "not met", "no topic /scam in the bag"),
        ("globally: /scam causes /scan", "vacuous", "no topic /scam"),
        ("after /cmd_vel {linear.x > 5}: no /scan", "vacuous", "opens its scope"),
        ("globally: no /cmd_vel {linear.x > 0.6}", "not met", "such a message"),
    ],
)
def test_a_property_says_why_it_is_vacuous_or_not_met(ros1: Path, hpl: str, status: str, found: str) -> None:
    [judgement] = judge(ros1, hpl=[hpl]).values()
    assert judgement.status == status
    assert found in judgement.found


def test_a_counterexample_has_the_values_of_the_fields_that_it_names(ros1: Path) -> None:
    [judgement] = judge(ros1, hpl=["globally: no /cmd_vel {linear.x > 0.6}"]).values()
    [witness] = judgement.witnesses
    assert (witness.topic, witness.after, dict(witness.values)) == ("/cmd_vel", 9.0, {"linear.x": "0.9"})


@pytest.mark.parametrize(
    ("section", "found"),
    [
        ({"hpl": ["globally: no /scan {range_min > 'x'}"]}, "column"),
        ({"hpl": ["globally: no /scan {intensity > 3}"]}, "no field 'intensity'"),
        ({"hpl": ["globally: no /scan {header.frame_id = 3}"]}, "a text compared with a number"),
        ({"hpl": ["globally: no /scan {ranges > 3}"]}, "expected a number"),
        (
            {
                "hpl": [
                    "globally: no /scan {forall i in ranges: forall k in [0 to 1000000]: ranges[@i] < ranges[0] + @k}"
                ]
            },
            "more than 1000000 values",
        ),
        ({"topics": {"/scan": {"fields": {"ranges": {"equals": "x"}}}}}, "expected a text"),
        ({"topics": {"/cmd_vel": {"max-latency": "1s"}}}, "no field 'header'"),
        ({"topics": {"/scan": {"fields": {"header": {"equals": 1}}}}}, "a message"),
    ],
)
def test_what_does_not_fit_the_messages_is_wrong_input(ros1: Path, section: dict[str, object], found: str) -> None:
    with pytest.raises(InputError, match=found):
        judge(ros1, **section)


def test_a_bag_without_messages_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no messages"):
        judge(bag_file(tmp_path, "bag", lambda _: None), hpl=["globally: no /x"])


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_bag_without_an_end_is_refused(kind: Kind, tmp_path: Path) -> None:
    path = bag_file(tmp_path, kind, drive)
    file = path if path.is_file() else next(path.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(InputError, match=r"truncated|cannot be read"):
        judge(file, hpl=["globally: some /scan"])


def test_a_damaged_message_is_refused(tmp_path: Path) -> None:
    def write(bag: BagFile) -> None:
        own_types(bag)
        bag.write("/battery", BEGIN, battery(bag, 1))
        bag.writer.write(bag._topics["/battery"], BEGIN + MS, b"\xff" * 20)

    path = bag_file(tmp_path, "bag", write)
    with pytest.raises(InputError, match="/battery: a message of own_msgs/msg/Battery"):
        judge(path, topics={"/battery": {"fields": {"state": {"equals": 1}}}})
