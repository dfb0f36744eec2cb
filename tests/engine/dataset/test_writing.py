import json
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration.base import ExitCode, InfrastructureError, InputError
from calibration.engine.dataset import writing
from calibration.engine.dataset.model import CornerLabels, Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.writing import DatasetWriter, SharedTexts, document_text, write_dataset, write_document
from calibration.engine.geometry.transforms import retract
from tests.engine.dataset import documents
from tests.engine.dataset.documents import MISSING, changed

REAL = ["t2rgb-paper", "synthetic/t2rgb", "synthetic/riwbot", "synthetic/rlbot"]


def assert_equal(a: Dataset, b: Dataset, atol: float = 0) -> None:
    """Everything a calibration uses is the same."""
    assert (a.world, a.anchored, a.additional_transforms, a.keys) == (
        b.world,
        b.anchored,
        b.additional_transforms,
        b.keys,
    )
    assert dict(a.sensors) == dict(b.sensors)
    assert set(a.transforms) == set(b.transforms)
    for edge, T in a.transforms.items():
        np.testing.assert_allclose(b.transforms[edge], T, rtol=0, atol=atol)
    assert list(a.patterns) == list(b.patterns)
    for name, pattern in a.patterns.items():
        other = b.patterns[name]
        assert (pattern.kind, pattern.link, pattern.parent_link, pattern.fixed) == (
            other.kind,
            other.link,
            other.parent_link,
            other.fixed,
        )
        np.testing.assert_array_equal(other.corners, pattern.corners)
        np.testing.assert_array_equal(other.outline, pattern.outline)
    for one, other in zip(a.collections, b.collections, strict=True):
        assert set(one.labels) == set(other.labels)
        for key, labels in one.labels.items():
            if isinstance(labels, CornerLabels):
                np.testing.assert_array_equal(other.labels[key].ids, labels.ids)
                np.testing.assert_array_equal(other.labels[key].pixels, labels.pixels)
            else:
                np.testing.assert_array_equal(other.labels[key].points, labels.points)
                np.testing.assert_array_equal(other.labels[key].limits, labels.limits)


def calibrated(dataset: Dataset, scale: float = 0.1) -> Dataset:
    """Every calibrated transform and pattern moved, the patterns differently in each collection."""
    generator = np.random.default_rng(7)
    moved = {}
    for sensor in dataset.sensors.values():
        moved[sensor.edge] = retract(dataset.transforms[sensor.edge], generator.normal(scale=scale, size=6))
    for pattern in dataset.patterns.values():
        moved[pattern.parent_link, pattern.link] = retract(
            np.broadcast_to(np.eye(4), (len(dataset.keys), 4, 4)), generator.normal(size=(len(dataset.keys), 6))
        )
    return dataset.with_transforms(moved)


def cannot_link(*_, **__):
    raise OSError(18, "Invalid cross-device link")


@pytest.fixture(params=[documents.document, documents.version_2])
def dataset(request, tmp_path):
    return read_dataset(documents.write(tmp_path / "in", request.param()))


def test_what_was_read_reads_back_equal(dataset, tmp_path):
    path = write_dataset(dataset, tmp_path / "out")
    assert path == tmp_path / "out" / "dataset.json"
    again = read_dataset(path)
    assert again.version == "3.0"
    assert_equal(dataset, again)
    assert all("transforms_ini" not in c for c in again.document["collections"].values())


def test_a_writer_of_several_datasets_writes_each_as_it_is_written_alone(dataset, tmp_path):
    several = DatasetWriter(dataset)
    made = [calibrated(dataset), dataset, calibrated(dataset, scale=0.2), dataset.with_collections([0])]
    for number, each in enumerate(made):
        alone = write_dataset(each, tmp_path / f"alone-{number}").read_bytes()
        assert several.write(each, tmp_path / f"{number}").read_bytes() == alone
        text = json.dumps(json.loads(alone), indent=2, sort_keys=True) + "\n"
        assert alone.decode() == text


def test_a_calibrated_dataset_reads_back_equal(dataset, tmp_path):
    result = calibrated(dataset)
    again = read_dataset(write_dataset(result, tmp_path / "out"))
    assert_equal(result, again, atol=1e-14)
    write_dataset(again, tmp_path / "third")
    assert_equal(again, read_dataset(tmp_path / "third"))


@pytest.mark.parametrize("name", REAL)
def test_real_datasets_read_back_equal(shared_data, tmp_path, name):
    dataset = read_dataset(shared_data / name)
    assert_equal(dataset, read_dataset(write_dataset(dataset, tmp_path / "plain")))
    result = calibrated(dataset)
    again = read_dataset(write_dataset(result, tmp_path / "calibrated"))
    assert_equal(result, again, atol=1e-14)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_transforms_and_any_choice_of_collections_read_back_equal(tmp_path, data):
    dataset = read_dataset(documents.write(tmp_path, documents.document()))
    keep = data.draw(st.sampled_from([[0], [1], [0, 1]]))
    twist = st.lists(st.floats(-3, 3), min_size=6, max_size=6).map(np.array)
    edges = data.draw(st.sets(st.sampled_from([*dataset.transforms, ("world", "board_link"), ("cam_optical", "lens")])))
    moved = {edge: retract(np.eye(4), data.draw(twist)) for edge in sorted(edges)}
    result = dataset.with_transforms(moved).with_collections(keep)
    assert_equal(result, read_dataset(write_dataset(result, tmp_path / "out")), atol=1e-14)


def test_the_input_is_not_changed(dataset, tmp_path):
    def content():
        return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in (tmp_path / "in").iterdir()}

    before, document = content(), json.dumps(dataset.document)
    write_dataset(calibrated(dataset), tmp_path / "out")
    assert content() == before
    assert json.dumps(dataset.document) == document


def test_the_input_is_never_overwritten(dataset, tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "in")
    for path in (tmp_path / "in", dataset.path, tmp_path / "link", tmp_path / "in" / ".." / "in"):
        with pytest.raises(InputError, match="an input is never changed"):
            write_dataset(dataset, path)


def test_a_file_beside_the_input(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "link", cannot_link)
    inode = (tmp_path / "in" / "lidar_000.pcd").stat().st_ino
    path = write_dataset(calibrated(dataset), tmp_path / "in" / "atom_calibration.json")
    assert path.name == "atom_calibration.json"
    assert read_dataset(path).keys == dataset.keys
    assert sorted(p.name for p in path.parent.iterdir()) == ["atom_calibration.json", "dataset.json", "lidar_000.pcd"]
    assert (tmp_path / "in" / "lidar_000.pcd").stat().st_ino == inode


def test_json_is_atoms(dataset, tmp_path):
    text = write_dataset(calibrated(dataset), tmp_path / "out").read_text()
    assert text == json.dumps(json.loads(text), indent=2, sort_keys=True) + "\n"


def test_the_same_bytes_every_time(dataset, tmp_path):
    first = write_dataset(calibrated(dataset), tmp_path / "a").read_bytes()
    again = read_dataset(dataset.path)
    assert write_dataset(calibrated(again), tmp_path / "b").read_bytes() == first


def test_the_initial_transforms_are_kept_under_other_names(tmp_path):
    dataset = read_dataset(documents.write(tmp_path / "in", documents.document()))
    written = json.loads(write_dataset(calibrated(dataset), tmp_path / "out").read_text())["collections"]["002"]
    read = dataset.document["collections"]["002"]["transforms"]
    assert written["transforms_ini"]["mount-cam_link"] == {
        **read["mount-cam_link"],
        "parent": "mount_ini",
        "child": "cam_link_ini",
    }
    assert set(written["transforms_ini"]) == set(read)
    assert set(written["transforms"]) == {*read, "world-board_link"}
    assert written["transforms"]["world-mount"] == read["world-mount"]  # not changed: to the last bit
    assert written["transforms"]["mount-cam_link"]["trans"] != read["mount-cam_link"]["trans"]


def test_an_uncalibrated_transform_keeps_its_other_keys(tmp_path):
    content = changed(documents.document(), {"collections/000/transforms/world-mount/note": "kept"})
    dataset = read_dataset(documents.write(tmp_path / "in", content))
    written = json.loads(write_dataset(calibrated(dataset), tmp_path / "out").read_text())
    assert written["collections"]["000"]["transforms"]["world-mount"]["note"] == "kept"


def test_version_2_becomes_version_3(tmp_path):
    dataset = read_dataset(documents.write(tmp_path / "in", documents.version_2()))
    written = json.loads(write_dataset(dataset, tmp_path / "out").read_text())
    assert written["_metadata"]["version"] == "3.0"
    assert written["_metadata"]["package_name"] == ""
    config = written["calibration_config"]
    assert "calibration_pattern" not in config
    assert list(config["calibration_patterns"]) == ["pattern_1"]
    assert config["calibration_patterns"]["pattern_1"]["dimension"] == {"x": 3, "y": 2}
    for key in ("anchored_sensor", "joints", "additional_tfs"):
        assert config[key] is None
    collection = written["collections"]["000"]
    assert set(collection["labels"]) == {"pattern_1"}
    assert (collection["joints"], collection["additional_data"]) == ({}, {})
    pattern = written["patterns"]["pattern_1"]
    assert pattern["corners"][4] == {"id": 4, "x": 0.1, "y": 0.1}
    assert pattern["frame"]["corners"]["top_left"] == pytest.approx({"x": -0.12, "y": -0.11})
    assert pattern["transforms_initial"] == {"000": {"detected": False}, "002": {"detected": False}}
    assert written["additional_sensor_data"] == {}


def test_patterns_of_version_3_are_written_in_full(tmp_path):
    dataset = calibrated(read_dataset(documents.write(tmp_path / "in", documents.document())))
    pattern = json.loads(write_dataset(dataset, tmp_path / "out").read_text())["patterns"]["board"]
    assert [corner["id"] for corner in pattern["corners"]] == list(range(6))
    lines = pattern["frame"]["lines_sampled"]
    assert {side: len(points) for side, points in lines.items()} == {"top": 22, "bottom": 22, "left": 16, "right": 16}
    assert lines["left"][0] == pattern["frame"]["corners"]["top_left"]
    assert lines["bottom"][-1] == pattern["frame"]["corners"]["bottom_right"]
    initial = pattern["transforms_initial"]["002"]
    assert (initial["detected"], initial["sensor"]) == (True, "cam")
    assert (initial["parent"], initial["child"]) == ("world", "board_link")
    np.testing.assert_allclose(initial["trans"], dataset.transforms["world", "board_link"][1, :3, 3])


def test_lines_are_sampled_as_in_a_dataset_of_atoms(shared_data, tmp_path):
    dataset = read_dataset(shared_data / "synthetic" / "rlbot")
    original = dataset.document["patterns"]["pattern_1"]
    frame = writing.pattern_document(dataset.patterns["pattern_1"], {})["frame"]
    for side, points in original["frame"]["lines_sampled"].items():
        ours = frame["lines_sampled"][side]
        np.testing.assert_allclose([[p["x"], p["y"]] for p in ours], [[p["x"], p["y"]] for p in points], atol=1e-14)


def test_the_border_of_a_pattern_as_large_as_can_be_does_not_fill_the_disk(tmp_path):
    square = {
        "top_left": (-1e6, -1e6),
        "top_right": (1e6, -1e6),
        "bottom_right": (1e6, 1e6),
        "bottom_left": (-1e6, 1e6),
    }
    frame = {"corners": {name: {"x": x, "y": y} for name, (x, y) in square.items()}}
    content = {**documents.document(), "patterns": {"board": {"frame": frame}}}
    path = write_dataset(read_dataset(documents.write(tmp_path / "in", content)), tmp_path / "out")
    assert len(json.loads(path.read_text())["patterns"]["board"]["frame"]["lines_sampled"]["top"]) == 10_000


def test_what_a_pattern_had_is_kept(tmp_path):
    initial = {"000": {"detected": False, "mine": 1}, "002": {"detected": False}}
    frame = {"lines_sampled": {"top": [{"x": 1, "y": 2}]}, "mine": 2}
    given = {"transforms_initial": initial, "frame": frame, "transitions": {"mine": []}, "mine": 3}
    content = {**documents.document(), "patterns": {"board": given}}
    dataset = read_dataset(documents.write(tmp_path / "in", content))
    written = json.loads(write_dataset(dataset.with_collections([0]), tmp_path / "out").read_text())["patterns"][
        "board"
    ]
    assert written["transforms_initial"] == {"000": {"detected": False, "mine": 1}}
    assert written["frame"]["lines_sampled"] == frame["lines_sampled"]
    assert (written["frame"]["mine"], written["mine"], written["transitions"]) == (2, 3, {"mine": []})
    assert len(written["corners"]) == 6
    assert written["frame"]["corners"]["top_left"] == {"x": -0.02, "y": -0.01}


def test_transforms_have_atoms_attributes(tmp_path):
    known = {"world-mount": {"parent": "world", "child": "mount", "type": "fixed", "joint_name": "bolt"}}
    dataset = read_dataset(documents.write(tmp_path / "in", {**documents.document(), "transforms": known}))
    written = json.loads(write_dataset(calibrated(dataset), tmp_path / "out").read_text())["transforms"]
    assert written["world-mount"] == known["world-mount"]
    assert written["world-board_link"]["type"] == "multiple"
    assert written["mount-cam_link"] == {
        "parent": "mount",
        "child": "cam_link",
        "type": "fixed",
        "is_transformation_calibrated": True,
        "from_bag": False,
        "joint_name": "",
        "joint_params_calibrated": [],
        "weight": 1,
    }
    assert written["lidar_base-lidar_frame"]["is_transformation_calibrated"] is False


def test_point_clouds_and_images_are_copied(tmp_path):
    dataset = read_dataset(documents.write(tmp_path / "in", documents.document()))
    (tmp_path / "in" / "cam_000.jpg").write_bytes(b"image")
    path = write_dataset(dataset, tmp_path / "out")
    names = sorted(p.name for p in path.parent.iterdir())
    assert names == ["cam_000.jpg", "dataset.json", "lidar_000.pcd"]
    assert (path.parent / "cam_000.jpg").samefile(tmp_path / "in" / "cam_000.jpg")  # no space is taken
    (tmp_path / "in" / "lidar_000.pcd").unlink()
    assert_equal(dataset, read_dataset(path))
    write_dataset(dataset, tmp_path / "out")  # what is there already may be written again


def test_images_may_stay_where_they_are(tmp_path):
    dataset = read_dataset(documents.write(tmp_path / "in", documents.document()))
    (tmp_path / "in" / "cam_000.jpg").write_bytes(b"image")
    path = write_dataset(dataset, tmp_path / "out", images=False)
    assert sorted(p.name for p in path.parent.iterdir()) == ["dataset.json", "lidar_000.pcd"]


def test_files_are_copied_where_they_cannot_be_linked(tmp_path, monkeypatch):
    dataset = read_dataset(documents.write(tmp_path / "in", documents.document()))
    monkeypatch.setattr(os, "link", cannot_link)
    path = write_dataset(dataset, tmp_path / "out")
    assert not (path.parent / "lidar_000.pcd").samefile(tmp_path / "in" / "lidar_000.pcd")
    assert_equal(dataset, read_dataset(path))


def test_files_in_folders_and_behind_links_are_copied(tmp_path):
    content = changed(documents.document(), {"collections/000/data/lidar/data_file": "clouds/a.pcd"})
    documents.write(tmp_path / "in", content)
    (tmp_path / "in" / "clouds").mkdir()
    (tmp_path / "in" / "lidar_000.pcd").rename(tmp_path / "in" / "b.pcd")
    (tmp_path / "in" / "clouds" / "a.pcd").symlink_to("../b.pcd")
    dataset = read_dataset(tmp_path / "in")
    assert_equal(dataset, read_dataset(write_dataset(dataset, tmp_path / "out")))
    assert not (tmp_path / "out" / "clouds" / "a.pcd").is_symlink()


@pytest.mark.parametrize("data_file", ["../secret", "/etc/passwd", 5, None, MISSING])
def test_files_outside_the_dataset_stay_there(tmp_path, data_file):
    (tmp_path / "secret").write_text("secret")
    content = changed(documents.document(), {"collections/000/data/cam/data_file": data_file})
    dataset = read_dataset(documents.write(tmp_path / "in", content))
    path = write_dataset(dataset, tmp_path / "a" / "out")
    assert [p.name for p in (tmp_path / "a").rglob("*")] == ["out", *(p.name for p in path.parent.iterdir())]
    assert sorted(p.name for p in path.parent.iterdir()) == ["dataset.json", "lidar_000.pcd"]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_not_written(tmp_path, value):
    dataset = read_dataset(documents.write(tmp_path / "in", documents.document()))
    T = np.eye(4)
    T[0, 3] = value
    with pytest.raises(InputError, match="transform 'mount-cam_link' is not finite") as caught:
        write_dataset(dataset.with_transforms({("mount", "cam_link"): T}), tmp_path / "out")
    assert caught.value.exit_code == ExitCode.BAD_INPUT
    assert not (tmp_path / "out").exists()


def test_a_transform_that_a_collection_lacks_stays_missing(tmp_path):
    content = documents.document()
    content["collections"]["002"]["transforms"] |= documents.edge("world", "board_link", [2.0, 0.0, 1.0])
    dataset = read_dataset(documents.write(tmp_path / "in", content))
    again = read_dataset(write_dataset(calibrated(dataset).with_transforms({}), tmp_path / "a"))
    assert np.isfinite(again.transforms["world", "board_link"]).all()
    T = dataset.transforms["world", "board_link"].copy()
    T[1, 0, 3] = 9
    written = write_dataset(dataset.with_transforms({("world", "board_link"): T}), tmp_path / "b")
    collections = json.loads(written.read_text())["collections"]
    assert "world-board_link" not in collections["000"]["transforms"]
    assert collections["002"]["transforms"]["world-board_link"]["trans"] == [9, 0, 1]


def test_a_transform_can_be_taken_away(tmp_path):
    content = documents.document()
    content["collections"]["002"]["transforms"] |= documents.edge("world", "board_link", [2.0, 0.0, 1.0])
    dataset = read_dataset(documents.write(tmp_path / "in", content))
    gone = dataset.with_transforms({("world", "board_link"): np.full((4, 4), np.nan)})
    assert ("world", "board_link") not in read_dataset(write_dataset(gone, tmp_path / "out")).transforms


def test_where_nothing_can_be_written(dataset, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InfrastructureError, match="cannot be written") as caught:
        write_dataset(dataset, tmp_path / "file" / "out")
    assert caught.value.exit_code == ExitCode.INFRASTRUCTURE
    assert "\n" not in str(caught.value)


def test_a_document_that_is_nested_too_deeply(tmp_path):
    nested = {}
    for _ in range(100_000):
        nested = {"a": nested}
    with pytest.raises(InputError, match="nested too deeply"):
        write_document(nested, tmp_path / "a.json")
    while nested:  # it would be taken apart recursively
        nested = nested.pop("a")


scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.sampled_from(["},\n    {", "[", '"'])
values = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=3), inner, max_size=4)
        | st.lists(st.dictionaries(st.text(max_size=3), scalars, max_size=3), max_size=4)
    ),
    max_leaves=20,
)


@given(st.dictionaries(st.text(), values))
def test_the_text_is_that_of_the_standard_library(document):
    assert document_text(document) == json.dumps(document, indent=2, sort_keys=True)


@given(st.dictionaries(st.text(), values), st.dictionaries(st.text(), values))
def test_what_documents_share_has_the_same_text_in_each(document, other):
    shared = SharedTexts(document.values())
    for each in (document, {**other, **document}, {"deeper": document}):
        assert document_text(each, shared) == json.dumps(each, indent=2, sort_keys=True)


def test_of_a_dataset_too():
    document = documents.document()
    assert document_text(document) == json.dumps(document, indent=2, sort_keys=True)


def test_tuples_are_lists():
    document = {"a": (1, 2, (3, {"b": ()}))}
    assert document_text(document) == json.dumps(document, indent=2, sort_keys=True)


@pytest.mark.parametrize("document", [{1: {"a": [[]]}}, {"a": object()}, {"a": [{"b": {1, 2}}]}])
def test_what_json_does_not_have(document):
    with pytest.raises(TypeError):
        document_text(document)
