"""calibration.yml: its keys, and the errors of invalid ones."""

from pathlib import Path

import pytest

from calibration.base import InputError
from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.options import ALL_EXACT, Assumptions
from calibration.pipeline.configuration import read_configuration

ROOT = Path(__file__).parents[2]


def write(folder: Path, text: str) -> Path:
    path = folder / "calibration.yml"
    path.write_text(text)
    return path


def test_the_repository_s_own_configuration_is_valid() -> None:
    configuration = read_configuration(ROOT / "calibration.yml")

    assert [system.name for system in configuration.systems] == ["t2rgb", "rlbot", "riwbot", "softbot", "spjbot"]
    assert configuration.noise.translations == (0.0, 0.5)
    assert configuration.noise.rotations == (0.0, 0.5)
    assert all(system.rules and system.limits.translation_mm for system in configuration.systems)


def test_paths_are_relative_to_the_file_and_variables_come_from_the_environment(tmp_path: Path) -> None:
    path = write(tmp_path, "systems: {a: {dataset: '${DATA}/a', truth: truth.json}}")

    (system,) = read_configuration(path, {"DATA": "data"}).systems

    assert system.dataset == tmp_path / "data" / "a"
    assert system.truth == str(tmp_path / "truth.json")


def test_a_system_has_its_own_options(tmp_path: Path) -> None:
    text = "{dataset: a, intrinsics: [left, right], intrinsics-covariance: known/intrinsics.json, hold: [left, board]}"

    (system,) = read_configuration(write(tmp_path, f"systems: {{a: {text}}}")).systems

    assert system.options.intrinsics == ("left", "right")
    assert system.options.intrinsics_covariance == tmp_path / "known" / "intrinsics.json"
    assert system.options.hold == ("left", "board")


def test_top_level_options_are_the_default_of_every_system(tmp_path: Path) -> None:
    text = "{start: given, hold: [left], systems: {a: {dataset: a}, b: {dataset: b, start: linear, hold: []}}}"

    first, second = read_configuration(write(tmp_path, text)).systems

    assert (first.options.start, first.options.hold) == ("given", ("left",))
    assert (second.options.start, second.options.hold) == ("linear", ())


@pytest.mark.parametrize("entry", ["intrinsics: left", "hold: [left, left]", "hold: ['']", "intrinsics-covariance: 3"])
def test_what_of_a_system_is_calibrated_has_one_form(tmp_path: Path, entry: str) -> None:
    with pytest.raises(InputError, match=rf"systems\.a\.{entry.split(':')[0]}"):
        read_configuration(write(tmp_path, f"systems: {{a: {{dataset: a, {entry}}}}}"))


@pytest.mark.parametrize(
    ("assume", "expected"),
    [
        ("{focal-length: -1}", "assume.focal-length: found -1, expected a number of at least 0"),
        ("{focal-length: much}", "assume.focal-length: found 'much', expected a number"),
        ("{focal-length: .nan}", "assume.focal-length: found nan, a finite number was expected"),
        ("{focal-lenght: 0}", "assume: unknown key 'focal-lenght': did you mean 'focal-length'?"),
        ("{border: [[1]]}", "assume.border: found a list of 1, expected a number"),
        ("[[exact]]", "assume: found a list of 1, expected exact or keys: focal-length"),
        ("exakt", "assume: found 'exakt', expected exact or keys: focal-length"),
    ],
)
def test_what_is_assumed_has_one_form(tmp_path: Path, assume: str, expected: str) -> None:
    with pytest.raises(InputError) as error:
        read_configuration(write(tmp_path, f"systems: {{a: {{dataset: a, assume: {assume}}}}}"))
    assert f"systems.a.{expected}" in str(error.value)
    assert "\n" not in str(error.value)


def test_what_is_calibrated_is_not_assumed(tmp_path: Path) -> None:
    calibrated = "systems: {a: {dataset: a, intrinsics: [all], assume: {focal-length: 0.01}}}"
    with pytest.raises(InputError, match=r"found .focal-length. beside 'intrinsics: all'.* leave one of them out"):
        read_configuration(write(tmp_path, calibrated))
    for good in ("assume: {border: 0.01}", "assume: exact", "hold: [intrinsics-left], assume: {focal-length: 0.01}"):
        read_configuration(write(tmp_path, f"systems: {{a: {{dataset: a, intrinsics: [all], {good}}}}}"))


def test_assume_and_description_at_the_top_apply_to_every_system(tmp_path: Path) -> None:
    text = "assume: exact\ndescription: rough\nsystems: {a: {dataset: a}, b: {dataset: b, assume: {border: 0.01}}}"
    a, b = read_configuration(write(tmp_path, text)).systems
    assert (a.options.assume, a.options.description) == (ALL_EXACT, "rough")
    assert (b.options.assume, b.options.description) == (Assumptions(border=0.01), "rough")


def test_defaults(tmp_path: Path) -> None:
    configuration = read_configuration(write(tmp_path, "systems: {a: {dataset: a}}"))

    assert configuration.noise.translations == (0.0,)
    assert configuration.noise.seeds == (1,)
    [system] = configuration.systems
    assert (system.options.start, system.options.loss) == ("linear", "huber")
    assert system.limits == Limits()


def test_a_number_of_seeds_means_the_seeds_from_one(tmp_path: Path) -> None:
    path = write(tmp_path, "noise: {seeds: 3}\nsystems: {a: {dataset: a}}")

    assert read_configuration(path).noise.seeds == (1, 2, 3)


def test_a_systems_limits_override_those_of_all(tmp_path: Path) -> None:
    text = "limits: {rms-px: 2}\nsystems: {a: {dataset: a}, b: {dataset: b, limits: {translation-mm: 1}}}"

    first, second = read_configuration(write(tmp_path, text)).systems

    assert first.limits == Limits(rms_px=2)
    assert second.limits == Limits(translation_mm=1)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("systems: {}", "systems"),
        ("- 1", "found a list of 1, expected keys: image, noise"),
        ("system: {a: {dataset: a}}", "unknown key 'system': did you mean 'systems'?"),
        ("image: {name: a, base: b}", "expected systems to calibrate, or a simulation"),
        ("systems: {a: {dataset: a, evalute: x}}", "systems.a: unknown key 'evalute': did you mean 'evaluate'?"),
        ("systems: {a: {}}", "systems.a"),
        ("systems: {a: {dataset: 3}}", "systems.a.dataset"),
        ("systems: {'../a': {dataset: a}}", "../a"),
        ("systems: {a: {dataset: a}}\nnoise: {translation: [-1]}", "noise.translation.0"),
        ("systems: {a: {dataset: a}}\nnoise: {translation: [.nan]}", "noise.translation.0"),
        ("systems: {a: {dataset: a}}\nnoise: {translation: []}", "noise.translation"),
        ("systems: {a: {dataset: a}}\nnoise: {seeds: 2, seed-list: [1]}", "exclude each other"),
        ("systems: {a: {dataset: a}}\nstart: guess", "start"),
        ("systems: {a: {dataset: a, rules: [{column: RMS}]}}", "systems.a.rules.0: RMS: the rule has no limit"),
        ("systems: {a: {dataset: a, rules: [{column: RMS, min: 2, max: 1}]}}", "systems.a.rules"),
        ("systems: {a: {dataset: a, limits: {}}}", "systems.a.limits"),
        ("systems: {a: {dataset: '${NO_SUCH}'}}", "NO_SUCH is not set"),
        ("systems: {a: {dataset: a}, a: {dataset: b}}", "occurs twice"),
        ("systems: [", "not valid YAML"),
        ("!!python/object/apply:os.system [true]", "not valid YAML"),
        ("a: &a [x, x]\nb: &b [*a, *a]\nsystems: *b", "systems"),
    ],
)
def test_one_line_names_file_and_key(tmp_path: Path, text: str, expected: str) -> None:
    path = write(tmp_path, text)

    with pytest.raises(InputError) as raised:
        read_configuration(path)

    assert str(raised.value).startswith(str(path))
    assert expected in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"calibration\.yml"):
        read_configuration(tmp_path / "calibration.yml")


def test_only_names_a_system_that_is_not_known() -> None:
    configuration = read_configuration(ROOT / "calibration.yml")

    assert [s.name for s in configuration.only(("riwbot",))] == ["riwbot"]
    with pytest.raises(InputError, match="did you mean 'riwbot'"):
        configuration.only(("riwbo",))


IMAGE = "image: {name: team/robot, base: 'debian:bookworm'}\n"
SOFTWARE = "systems: {a: {dataset: a, software: {command: 'run {start}'}}}"
COLLECTED = "systems: {a: {dataset: 'simulation:fresh'}}\n"
CONTAINERS = "simulation: {fresh: {containers: {robot: {command: run}}}}"


def test_software_and_applications_run_in_the_image_unless_they_name_another(tmp_path: Path) -> None:
    text = IMAGE + COLLECTED + "simulation: {fresh: {containers: {robot: {command: run}, sim: {image: other}}}}"

    configuration = read_configuration(write(tmp_path, text))

    assert configuration.image is not None
    assert configuration.image.name == "team/robot"
    assert configuration.systems[0].collected == "fresh"
    [request] = configuration.simulations
    assert [c.image for c in request.applications.with_image("built").containers] == ["built", "other"]


def test_what_the_software_says(tmp_path: Path) -> None:
    text = (
        "systems: {a: {dataset: a, software: {image: i, command: [run, '{seed}'], ros: 1, network: internal, "
        "memory: 1g, table: '*.csv', mounts: ['data:/data'], artifacts: ['{output}/x']}}}"
    )
    (tmp_path / "data").mkdir()

    software = read_configuration(write(tmp_path, text)).systems[0].software

    assert software is not None
    assert (software.ros, software.network, software.table) == ("1", "internal", "*.csv")
    assert software.container.mounts[0].source == tmp_path / "data"
    assert software.container.limits.memory == 1024**3


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (SOFTWARE, "systems.a.software: missing image, as there is no section image"),
        (COLLECTED + CONTAINERS, "simulation.fresh.containers.robot: missing image"),
        (COLLECTED, "systems.a.dataset: simulation has no entry 'fresh'"),
        (IMAGE + COLLECTED + CONTAINERS.replace("fresh", "frech"), "did you mean 'frech'?"),
        ("systems: {a: {dataset: a, software: {image: i}}}", "systems.a.software"),
        (SOFTWARE.replace("command", "comand"), "systems.a.software"),
        (SOFTWARE.replace("start", "strat"), "systems.a.software.command: there is no placeholder '{strat}'"),
        (IMAGE + SOFTWARE.replace("}'}}}", "}', memory: much}}}"), "systems.a.software.memory: found 'much'"),
        ("image: {name: x}\n" + SOFTWARE, "image"),
        ("image: {name: x, base: b, atp: [y]}\n" + SOFTWARE, "image: unknown key 'atp': did you mean 'apt'?"),
        (IMAGE + COLLECTED + "simulation: {fresh: {system: s, ros: 1}}", "simulation.fresh"),
        (
            IMAGE + COLLECTED + "simulation: {fresh: {system: s, backend: docker}}",
            "found docker; containers run with docker or aws-batch",
        ),
        (IMAGE + COLLECTED + CONTAINERS.replace("{containers", "{backend: embedded, containers"), "found embedded"),
        (IMAGE + COLLECTED + CONTAINERS.replace("}}}}", "}}, player: ros2}}"), "simulation.fresh.player"),
        (IMAGE + COLLECTED + CONTAINERS.replace("command", "comand"), "robot: unknown key 'comand': did you mean"),
    ],
)
def test_one_line_about_containers(tmp_path: Path, text: str, expected: str) -> None:
    path = write(tmp_path, text)

    with pytest.raises(InputError) as raised:
        read_configuration(path)

    assert expected in str(raised.value)
    assert "\n" not in str(raised.value)
