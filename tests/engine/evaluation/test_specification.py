"""Evaluations by their text."""

import csv
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.base import InputError
from calibration.engine.dataset.modalities import RGB
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.evaluation.specification import TABLE_KINDS, Evaluation, parse_evaluation
from calibration.engine.evaluation.truth import Truth, find_truth, truth_of
from calibration.engine.evaluation.two_sensors import (
    annotation_for,
    inter_collection_rgb_to_rgb,
    lidar_to_rgb,
    rgb_to_rgb,
)
from calibration.engine.geometry.transforms import retract
from tests.engine.evaluation.scene import (
    T_LINK_OPTICAL,
    arm,
    lidar_and_camera,
    range_pair,
    rgb,
    two_cameras,
    with_corners,
)


def test_the_text_names_kind_sensors_and_pattern():
    assert parse_evaluation("rgb-to-rgb:right_camera:left_camera") == Evaluation(
        "rgb-to-rgb", ("right_camera", "left_camera")
    )
    assert parse_evaluation(" lidar-to-rgb : lidar : eye : board ") == Evaluation(
        "lidar-to-rgb", ("lidar", "eye", "board")
    )


names = st.text(st.characters(categories=("L", "N"), include_characters="_-"), min_size=1)


@given(kind=st.sampled_from(sorted(TABLE_KINDS)), some=st.data())
def test_what_is_printed_reads_back(kind, some):
    least, most = len(TABLE_KINDS[kind].needs), len(TABLE_KINDS[kind].needs + TABLE_KINDS[kind].may)
    evaluation = Evaluation(kind, tuple(some.draw(st.lists(names, min_size=least, max_size=most))))
    assert parse_evaluation(str(evaluation)) == evaluation


@pytest.mark.parametrize("text", ["", "rgb:a:b", "rgb_to_rgb:a:b", "lidar-to-lidars:a:b"])
def test_an_unknown_table_is_told_those_there_are(text):
    with pytest.raises(
        InputError, match=r"there is no table '.*' \(tables: rgb-to-rgb, inter-.*, ground-truth-frame\)"
    ):
        parse_evaluation(text)


@pytest.mark.parametrize(
    ("text", "form"),
    [
        ("rgb-to-rgb", r"rgb-to-rgb:SOURCE:TARGET\[:PATTERN\]"),
        ("rgb-to-rgb:a", r"rgb-to-rgb:SOURCE:TARGET\[:PATTERN\]"),
        ("rgb-to-rgb:a:", r"rgb-to-rgb:SOURCE:TARGET\[:PATTERN\]"),
        ("rgb-to-rgb::b", r"rgb-to-rgb:SOURCE:TARGET\[:PATTERN\]"),
        ("rgb-to-rgb:a:b:c:d", r"rgb-to-rgb:SOURCE:TARGET\[:PATTERN\]"),
        ("inter-collection-lidar-to-rgb:a", r"inter-collection-lidar-to-rgb:LIDAR:CAMERA\[:PATTERN\]"),
        ("single-rgb:a:b:c", r"single-rgb\[:CAMERA\]\[:PATTERN\]"),
        ("ground-truth-transform:a:b:c", "ground-truth-transform:PARENT:CHILD"),
        ("ground-truth-frame", r"ground-truth-frame:FRAME\[:SENSOR\]"),
    ],
)
def test_other_names_are_told_the_form(text, form):
    with pytest.raises(InputError, match=f"evaluation '{text}': expected {form}$"):
        parse_evaluation(text)


@pytest.mark.parametrize(
    ("text", "sensors"),
    [
        ("rgb-to-rgb:a:b:board", ("a", "b")),
        ("lidar-to-depth:a:b", ("a", "b")),
        ("single-rgb", ()),
        ("single-rgb:a:board", ("a",)),
        ("ground-truth-transform:world:link", ()),
        ("ground-truth-frame:world:a", ("a",)),
    ],
)
def test_which_names_are_sensors(text, sensors):
    assert parse_evaluation(text).sensors == sensors


def test_each_kind_runs_its_table():
    pair, hand = two_cameras(n=3, noise=0.3)[0], arm(n=4, noise=0.3)
    assert (
        parse_evaluation("rgb-to-rgb:left:right:board").run(pair).to_csv() == rgb_to_rgb(pair, "left", "right").to_csv()
    )
    assert (
        parse_evaluation("inter-collection-rgb-to-rgb:eye:eye").run(hand).to_csv()
        == inter_collection_rgb_to_rgb(hand, "eye", "eye").to_csv()
    )
    both, _ = lidar_and_camera(n=2)
    annotation = annotation_for(both, "eye", both.patterns["board"], None)
    assert (
        parse_evaluation("lidar-to-rgb:scan:eye").run(both).to_csv()
        == lidar_to_rgb(both, "scan", "eye", annotation).to_csv()
    )


def test_each_table_of_range_sensors_and_truth_runs():
    two = (("lidar-to-lidar", ("lidar3d", "lidar3d")), ("lidar-to-depth", ("lidar3d", "depth")))
    for name, kinds in (*two, ("depth-to-depth", ("depth", "depth"))):
        for prefix, rows in (("", 2), ("inter-collection-", 4)):
            base, _ = range_pair(n=2, kinds=kinds, fixed=True)
            assert len(parse_evaluation(f"{prefix}{name}:one:two:board").run(base).labels) == rows
    base, _ = range_pair(n=2, kinds=("depth", "depth"), fixed=True)
    base = replace(base, sensors={**base.sensors, "two": replace(base.sensors["two"], modality=RGB)})
    truth = truth_of(base)
    for text, rows in (
        ("depth-to-rgb:one:two", 2),
        ("inter-collection-depth-to-rgb:one:two", 4),
        ("ground-truth-transform:world:one_link", 2),
        ("ground-truth-frame:world", 1),
        ("ground-truth-frame:world:two", 2),
    ):
        assert len(parse_evaluation(text).run(base, truth).labels) == rows
    assert len(parse_evaluation("single-rgb:eye:board").run(arm(n=3)).labels) == 3
    assert parse_evaluation("single-rgb").run(arm(n=3)).columns == ("eye-board [px]", "all [px]")


OURS = "measured-poses"


def test_every_table_of_atom_is_there():
    with_pairs = ("rgb-to-rgb", "lidar-to-rgb", "depth-to-rgb", "lidar-to-lidar", "lidar-to-depth", "depth-to-depth")
    single = {"single-rgb", "ground-truth-transform", "ground-truth-frame"}
    pairs = {f"{prefix}{name}" for prefix in ("", "inter-collection-") for name in with_pairs}
    assert set(TABLE_KINDS) == single | pairs | {OURS}


PIXELS = "RMS (pix),X err (pix),Y err (pix)"
SPREAD = "X StDev (pix),Y StDev (pix)"
METRES = "RMS (m),X err (m),Y err (m),X StDev (m),Y StDev (m)"
ERRORS = "Trans (m),Rot (rad),X (m),Y (m),Z (m),Roll (rad),Pitch (rad),Yaw (rad)"
HEADERS = {
    "rgb-to-rgb:one:two": f"Collection #,{PIXELS},Trans (mm),Rot (deg)",
    "inter-collection-rgb-to-rgb:one:two": f"Collection #,{PIXELS},Trans (mm),Rot (deg)",
    "single-rgb": "Collection,one-board [px],two-board [px],all [px]",
    "lidar-to-rgb:one:two": f"Collection #,{PIXELS}",
    "inter-collection-lidar-to-rgb:one:two": f"Collection Pair,{PIXELS}",
    "depth-to-rgb:one:two": f"Collection #,{PIXELS}",
    "inter-collection-depth-to-rgb:one:two": f"Collection #,{PIXELS}",
    "lidar-to-lidar:one:two": f"Collection #,{METRES}",
    "inter-collection-lidar-to-lidar:one:two": f"Collection Pair,{METRES}",
    "lidar-to-depth:one:two": f"Collection #,{PIXELS},{SPREAD}",
    "inter-collection-lidar-to-depth:one:two": f"Collection #,{PIXELS},{SPREAD}",
    "depth-to-depth:one:two": f"Collection #,{PIXELS},{SPREAD}",
    "inter-collection-depth-to-depth:one:two": f"Collection #,{PIXELS},{SPREAD}",
    "ground-truth-transform:world:one_link": f"Collection #,{ERRORS}",
    "ground-truth-frame:world": f"Transformation #,{ERRORS}",
}
"""Of ATOM's files, by their tables."""


def test_the_headers_are_those_of_all_tables():
    assert {parse_evaluation(text).kind for text in HEADERS} == set(TABLE_KINDS) - {OURS}


@pytest.mark.parametrize("text", HEADERS)
def test_the_file_is_as_atoms(text):
    """Its header, its rows in order, four decimals, and below them the means of what is printed."""
    kinds = [kind.replace("lidar", "lidar3d") for kind in re.findall("rgb|lidar|depth", text)] or ["rgb"]
    base, truth = seen_by((kinds * 2)[0], (kinds * 2)[1])
    header, *rows = csv.reader(io.StringIO(parse_evaluation(text).run(base, truth).to_csv()))
    assert ",".join(header) == HEADERS[text]
    assert TABLE_KINDS[parse_evaluation(text).kind].rms == ("RMS (pix)" if "RMS (pix)" in header else None)
    pairs = [f"{a}-{b}" for a in base.keys for b in base.keys]
    alone = ["one", "two"] if text.startswith("ground-truth-frame") else list(base.keys)
    assert [row[0] for row in rows] == [*(pairs if text.startswith("inter-") else alone), "Averages"]
    assert all(re.fullmatch(r"-?\d+\.\d{4}", cell) for row in rows for cell in row[1:])
    assert "-0.0000" not in {cell for row in rows for cell in row}
    values = np.array([[float(cell) for cell in row[1:]] for row in rows])
    np.testing.assert_allclose(values[-1], values[:-1].mean(0), atol=5.1e-5)
    assert np.abs(values).max() > 0


def seen_by(*kinds):
    """Two sensors that see a fixed pattern, with noise on their labels, and their true transforms."""
    seen = ["lidar3d" if kind == "rgb" else kind for kind in kinds]
    base, T_world_pattern = range_pair(3, n=3, kinds=(seen[0], seen[1]), fixed=True, noise=2e-3)
    base = replace(base, anchored=None)
    rng = np.random.default_rng(3)
    for name in (name for name, kind in zip(("one", "two"), kinds, strict=True) if kind == "rgb"):
        camera = rgb(name)
        alone = replace(base, sensors={name: camera}).with_transforms(
            {camera.edge: np.eye(4), (camera.calibration_child, camera.frame): T_LINK_OPTICAL}
        )
        alone = with_corners(alone, T_world_pattern, rng, 0.3)
        base = replace(alone, sensors={**base.sensors, name: camera})
    edge = base.sensors["one"].edge
    off = np.broadcast_to([0.01, -0.02, 0.01, 0.01, 0.01, -0.01], (3, 6))
    return base.with_transforms({edge: retract(base.transforms[edge], off)}), truth_of(base)


# Where the annotation comes from


def test_without_truth_it_is_the_cameras_own():
    base, _ = lidar_and_camera(n=2)
    np.testing.assert_allclose(parse_evaluation("lidar-to-rgb:scan:eye").run(base).values, 0, atol=1e-3)


def with_pattern_poses(seed: int):
    base, T_world_pattern = lidar_and_camera(seed=seed, n=3)
    return base, truth_of(base.with_transforms({("world", "board_link"): T_world_pattern}))


def test_the_truth_comes_before_the_cameras_own():
    base, truth = with_pattern_poses(1)
    edge = ("eye_mount", "eye_link")
    wrong = base.with_transforms({edge: retract(base.transforms[edge], np.broadcast_to([0, 0.02, 0, 0, 0, 0], (3, 6)))})
    board = base.patterns["board"]
    right, of_wrong = (annotation_for(d, "eye", board, truth) for d in (base, wrong))
    for key, segments in right.items():
        np.testing.assert_allclose(of_wrong[key], segments, atol=1e-9)  # the image does not know the wrong transform
    assert parse_evaluation("lidar-to-rgb:scan:eye").run(base, truth).average("RMS (pix)") < 1e-4
    assert parse_evaluation("lidar-to-rgb:scan:eye").run(wrong, truth).average("RMS (pix)") > 2


def test_a_fixed_pattern_has_one_true_pose():
    base, truth = with_pattern_poses(2)
    edge = ("world", "board_link")
    fixed = Truth(truth.path, truth.sensors, {**truth.transforms, edge: truth.patterns["001"][edge]}, {})
    annotation = annotation_for(base, "eye", base.patterns["board"], fixed)
    assert list(annotation) == ["000", "001", "002"]
    np.testing.assert_array_equal(annotation["000"], annotation["002"])


def test_a_truth_without_pattern_poses_leaves_it_to_the_camera():
    base, truth = with_pattern_poses(3)
    bare = Truth(truth.path, truth.sensors, truth.transforms, {})
    np.testing.assert_allclose(parse_evaluation("lidar-to-rgb:scan:eye").run(base, bare).values, 0, atol=1e-3)


def test_a_file_beside_the_dataset_comes_first(tmp_path):
    base, truth = with_pattern_poses(4)
    side = {"ixs": [0, 1], "iys": [0, 0]}
    (tmp_path / "annotation_eye.json").write_text(
        json.dumps({"000": dict.fromkeys(("top", "right", "bottom", "left"), side)})
    )
    here = replace(base, path=tmp_path / "dataset.json")
    table = parse_evaluation("lidar-to-rgb:scan:eye").run(here, truth)
    assert table.labels == ("000",)
    assert table.average("RMS (pix)") > 100


def test_the_synthetic_truth_gives_the_annotation_that_came_with_it(shared_data, tmp_path):
    base = read_dataset(shared_data / "synthetic" / "rlbot")
    truth = find_truth(base)
    given, made = (
        parse_evaluation("lidar-to-rgb:lidar_right:rgb_left").run(d, truth)
        for d in (base, replace(base, path=tmp_path / "dataset.json"))
    )
    np.testing.assert_allclose(made.values, given.values, atol=1e-6)
