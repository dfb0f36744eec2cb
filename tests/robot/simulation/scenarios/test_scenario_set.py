import random

import pytest

from calibration.base import InputError
from calibration.robot.simulation.scenarios.scenario import build_world, clearance
from calibration.robot.simulation.scenarios.scenario_set import CLEARANCE_KEY, read_scenario_set
from calibration.robot.simulation.system import System
from tests.robot.simulation.conftest import DATASETS
from tests.robot.simulation.scenarios.conftest import ReadSet

LIGHT = "light: {ambient: {uniform: [0.2, 0.9]}, intensity: {uniform: [0, 1]}}\n"
CAMERAS = "cameras: {noise_levels: {log_uniform: [0.5, 8]}, k1: {normal: [0, 0.1]}}\n"
OCCLUDERS = "occluders: {count: {integer: [1, 4]}, size_m: {uniform: [0.1, 0.4]}}\n"


def test_a_group_has_a_parameter_for_each_of_its_things(read_set: ReadSet) -> None:
    scenarios = read_set("""
cameras: {exposure: 1.5}
lidars: {noise_m: {uniform: [0.01, 0.02]}}
assembly: {translation_mm: 1, rotation_deg: 2}
pattern: {bow_mm: 3}
motion: {sway_mm: 4}
""")
    assert dict(scenarios.scenario(1, 0).values) == {
        "motion.sway_mm": 4,
        "pattern_1.bow_x_mm": 3,
        "pattern_1.bow_y_mm": 3,
        "left_camera.exposure": 1.5,
        "right_camera.exposure": 1.5,
        **{f"{side}_camera.translation_{axis}_mm": 1 for side in ("left", "right") for axis in "xyz"},
        **{f"{side}_camera.rotation_{axis}_deg": 2 for side in ("left", "right") for axis in "xyz"},
    }


def test_an_anchored_sensor_is_where_it_was_designed_to_be(read_set: ReadSet) -> None:
    scenarios = read_set("assembly: {translation_mm: 1}\nlidars: {noise_m: 0.01}", "rlbot")
    assert set(scenarios.parameters.distributions) == {
        "lidar_right.noise_m",
        *(f"lidar_right.translation_{axis}_mm" for axis in "xyz"),
    }


def test_joints_vary_by_the_unit_of_their_parameters(read_set: ReadSet) -> None:
    scenarios = read_set("joints: {translation_mm: 2, rotation_deg: {normal: [0, 1]}}", "spjbot")
    values = scenarios.scenario(1, 0).values
    assert values["j3_joint.origin_z.translation_mm"] == 2
    angles = {"j2_joint.origin_yaw.rotation_deg", "j4_joint.origin_yaw.rotation_deg"}
    assert set(values) == {"j3_joint.origin_z.translation_mm", *angles}
    assert len({values[name] for name in angles}) == 2
    assert set(read_set("joints: {rotation_deg: 1}", "riwbot").scenario(1, 0).values) == set()


def test_an_entry_of_one_sensor_overrides_that_of_all(read_set: ReadSet) -> None:
    scenarios = read_set("cameras: {exposure: 1.5, k1: 0.1}\nsensors: {right_camera: {exposure: 2, translation_mm: 1}}")
    values = scenarios.scenario(1, 0).values
    assert (values["left_camera.exposure"], values["right_camera.exposure"]) == (1.5, 2)
    assert values["right_camera.k1"] == 0.1
    assert values["right_camera.translation_x_mm"] == 1
    assert "left_camera.translation_x_mm" not in values


def test_any_part_of_the_scenarios_in_any_order_is_a_part_of_the_whole(read_set: ReadSet) -> None:
    scenarios = read_set(LIGHT + CAMERAS + "constraints: [{less: [light.intensity, light.ambient]}]")
    whole = [scenarios.scenario(3, index) for index in range(40)]
    some = random.Random(0).sample(range(40), 15)
    assert [scenarios.scenario(3, index) for index in some] == [whole[index] for index in some]
    assert len({tuple(scenario.values.values()) for scenario in whole}) == 40
    assert scenarios.scenario(4, 0).values != whole[0].values


def test_these_are_the_values_on_every_machine(read_set: ReadSet) -> None:
    values = read_set(LIGHT + CAMERAS).scenario(1, 17).values
    assert dict(values) == {
        "light.ambient": 0.350687,
        "light.intensity": 0.448032,
        "left_camera.noise_levels": 2.62974,
        "right_camera.noise_levels": 6.37355,
        "left_camera.k1": -0.0131829,
        "right_camera.k1": -0.0925513,
    }


def test_a_parameter_more_leaves_the_values_of_the_others(read_set: ReadSet) -> None:
    few, more = read_set(LIGHT).scenario(1, 5).values, read_set(CAMERAS + LIGHT).scenario(1, 5).values
    assert {name: more[name] for name in few} == few
    assert len(more) == len(few) + 4


def test_how_the_file_is_laid_out_does_not_matter(read_set: ReadSet) -> None:
    one = read_set(LIGHT).scenario(1, 5)
    other = read_set("# dark\nlight:\n  intensity:\n    uniform: [0.0, 1.0]\n  ambient: {uniform: [0.20, 0.90]}\n")
    assert other.scenario(1, 5) == one


def test_every_scenario_keeps_to_the_constraints(read_set: ReadSet) -> None:
    scenarios = read_set(
        LIGHT
        + CAMERAS
        + """
constraints:
  - {less: [light.intensity, light.ambient]}
  - {parameter: cameras.noise_levels, min: 1, max: 6}
  - {less: [left_camera.k1, right_camera.k1]}
"""
    )
    scenarios = [scenarios.scenario(1, index) for index in range(60)]
    for scenario in scenarios:
        values = scenario.values
        assert values["light.intensity"] < values["light.ambient"]
        assert values["left_camera.k1"] < values["right_camera.k1"]
        assert all(1 <= values[f"{side}_camera.noise_levels"] <= 6 for side in ("left", "right"))
    assert {scenario.attempt for scenario in scenarios} > {0, 1, 2}  # about one draw in seven keeps to them


def test_a_scenario_that_keeps_to_the_constraints_is_drawn_as_without_them(read_set: ReadSet) -> None:
    free, bound = read_set(LIGHT), read_set(LIGHT + "constraints: [{less: [light.intensity, light.ambient]}]")
    for index in range(30):
        values = free.scenario(1, index).values
        kept = values["light.intensity"] < values["light.ambient"]
        assert (bound.scenario(1, index) == free.scenario(1, index)) == kept


def test_sensors_keep_a_distance_from_boxes(read_set: ReadSet) -> None:
    near = read_set(OCCLUDERS)
    scenarios = read_set(OCCLUDERS + f"constraints: [{{parameter: {CLEARANCE_KEY}, min: 0.35}}]")
    before = [clearance(build_world(near.system, near.scenario(1, i))) for i in range(30)]
    after = [clearance(build_world(scenarios.system, scenarios.scenario(1, i))) for i in range(30)]
    assert min(before) < 0.35 <= min(after)


def test_a_constraint_that_nothing_keeps_to_is_named(read_set: ReadSet) -> None:
    scenarios = read_set(
        LIGHT + "constraints: [{parameter: light.ambient, min: 0.3}, {parameter: light.intensity, min: 2}]"
    )
    with pytest.raises(
        InputError, match=r"scenarios.yml: constraints.1: 'light.intensity at least 2' is broken by [89]"
    ):
        scenarios.scenario(1, 17)


def test_the_set_that_ships_fits_every_system(systems: dict[str, System]) -> None:
    for system in systems.values():
        scenarios = read_scenario_set(DATASETS / "scenarios.yml", system)
        assert all(scenarios.scenario(1, index).values for index in range(20))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found null, expected keys: light, occluders, motion, pattern, joints, cameras, lidars, d"),
        ("[]", "found an empty list, expected keys: light, occluders, motion, pattern, joints, cameras, "),
        ("light: [", "this is not valid YAML"),
        ("light: 1", "light: found 1, expected keys: ambient, intensity, elevation_deg, azimuth_deg"),
        (
            "lihgt: {}",
            "unknown key 'lihgt': did you mean 'light'? (known: light, occluders, motion, pattern, jo",
        ),
        ("1: {}", "unknown key 1 (known: light, occluders, motion, pattern, joints, cameras, lidars, depth_"),
        (
            "light: {brightness: 1}",
            "light: unknown key 'brightness' (known: ambient, intensity, elevation_deg, azimuth_deg)",
        ),
        ("light: {ambient: 1, ambient: 2}", "the key 'ambient' occurs twice"),
        ("light: {ambient: {uniform: [0, .inf]}}", "light.ambient.uniform.1: found inf, expected a number"),
        ("light: {ambient: -1}", "light.ambient: found values from -1 to -1, expected them from 0 to 10"),
        ("light: {elevation_deg: 10}", "light: elevation_deg needs azimuth_deg: say azimuth_deg too"),
        ("occluders: {count: 1}", "occluders: count needs size_m: say size_m too"),
        (
            "occluders: {count: 1.5, size_m: 1}",
            "occluders.count: found 1.5, expected a whole number or keys: choice, integer",
        ),
        ("motion: {nearest_m: 1}", "motion: nearest_m needs farthest_m: say farthest_m too"),
        ("motion: {poses: {uniform: [1, 9]}}", "motion.poses: unknown key 'uniform' (known: choice, integer)"),
        (
            "pattern: {bow_mm: {normal: [0, -1]}}",
            "pattern.bow_mm.normal: found a standard deviation of -1, expected one above 0",
        ),
        (
            "sensors: {front: {exposure: 1}}",
            "sensors: unknown key 'front' (known: left_camera, right_camera)",
        ),
        (
            "sensors: {left_camera: {noise_m: 1}}",
            "sensors.left_camera: unknown key 'noise_m': did you mean 'noise_levels'? (known: exposur",
        ),
        ("constraints: {}", "constraints: found an empty mapping, expected a list of at most 100"),
        ("constraints: [1]", "constraints.0: found 1, expected keys: parameter, min, max, less"),
        (
            "constraints: [{parameter: light.ambient, min: 1}]",
            "constraints.0: found 'light.ambient', which this scenario set does not draw (it draws sc",
        ),
        (
            "constraints: [{parameter: scene.clearance_m}]",
            "constraints.0: found neither 'min' nor 'max', expected one of them or both",
        ),
        ("constraints: [{parameter: scene.clearance_m, min: 2, max: 1}]", "constraints.0: found min 2 above max 1"),
        (
            "constraints: [{parameter: scene.clearance_m, least: 2}]",
            "constraints.0: unknown key 'least': did you mean 'less'? (known: parameter, min, max, le",
        ),
        (
            "constraints: [{less: [scene.clearance_m]}]",
            "constraints.0.less: found a list of 1, expected a list of at least 2",
        ),
        (
            "constraints: [{less: [scene.clearance_m, 1]}]",
            "constraints.0.less.1: found 1, expected a text that is not empty: put it in quotes",
        ),
        (
            "constraints: [{less: [scene.clearance_m, a], min: 1}]",
            "constraints.0: less and min exclude each other",
        ),
        ("constraints: [{parameter: '__import__(\"os\")', min: 1}]", "which this scenario set does not draw"),
        ("a: &a [*a, *a]", "1: this is not valid YAML: its aliases expand to more than 100000 values"),
        ("light: !!python/object/apply:os.system [echo]", "this is not valid YAML"),
    ],
)
def test_what_is_wrong_in_a_set_is_said_in_one_line(read_set: ReadSet, text: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        read_set(text)
    assert message in str(error.value)
    assert "\n" not in str(error.value)
