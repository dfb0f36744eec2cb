"""The catalogue of defects: its scenes are what they say, and a share of it is judged."""

import numpy as np
import pytest

from benchmarks.verdict import summary
from benchmarks.verdict.case import Case, Outcome, run
from benchmarks.verdict.kind import Kind
from benchmarks.verdict.kinds import KINDS
from benchmarks.verdict.scene import Scene
from benchmarks.verdict.strata import Conditions, at_zero, clean, moving_edges, recording
from benchmarks.verdict.unforeseen import UNFORESEEN
from calibration.engine.dataset.model import CornerLabels, PointLabels
from calibration.engine.geometry.transforms import inverse


@pytest.fixture(scope="module")
def good() -> Outcome:
    return run(Case("clean", "good", "riwbot", 0, 0, limits=False))


def test_the_catalogue_is_large_enough() -> None:
    assert len({kind.name for kind in KINDS}) == len(KINDS) >= 60
    assert all(kind.sizes and kind.words for kind in KINDS)


def test_a_clean_robot_is_no_harm_and_green(good: Outcome) -> None:
    assert (good.limits or 9) < 1
    assert not good.reasons
    assert not good.warnings


def test_a_scene_is_the_truth_with_noise() -> None:
    scene = clean("exact", "riwbot", 0)
    collection = scene.told.collections[3]
    ((_, sensor), labels) = next(iter(collection.labels.items()))
    assert isinstance(labels, CornerLabels)
    difference = labels.pixels - scene.expected(3, sensor, labels.ids)
    assert 0.03 < np.std(difference) < 0.2


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("kind", ["focal length", "joint origin x", "pushed sensor"])
def test_a_large_defect_does_harm(kind: str) -> None:
    outcome = run(Case(kind, "exact", "riwbot", 2, 0))
    assert outcome.harmful
    assert not outcome.memory


def test_defects_that_do_nothing_do_no_harm() -> None:
    case = Case("described elsewhere", "exact", "riwbot", 0, 0)
    outcome = run(case)
    assert (outcome.limits or 9) < 1
    assert not outcome.must_be_red


def test_the_table_counts_what_was_found(good: Outcome) -> None:
    rows = [good, run(Case("focal length", "exact", "riwbot", 2, 0))]
    table = summary.readme_table(rows)
    assert table.splitlines()[2].startswith("| focal length |")
    assert any("focal length" in line for line in summary.lines(rows))


@pytest.mark.thorough(but_first=10)
@pytest.mark.parametrize("kind", UNFORESEEN, ids=lambda kind: kind.name)
def test_a_kind_that_no_check_was_written_for_changes_what_the_user_has(kind: Kind) -> None:
    system = kind.systems[-1]
    base = clean("exact", system, 0)
    sizes = (0, 2) if kind.unit != "variant" else range(3)
    changes = [_change(base, Case(kind.name, "exact", system, size, 0).scene()) for size in sizes]
    assert min(changes) > 0
    assert kind.unit in ("variant", "times") or changes[0] < changes[-1]


def _change(base: Scene, scene: Scene) -> float:
    """How far labels and what is told of the robot are from a scene's, in px, m and rad alike."""
    change = 0.0
    for was, now in zip(base.told.collections, scene.told.collections, strict=True):
        for key, label in now.labels.items():
            before = was.labels[key]
            if isinstance(label, CornerLabels) and isinstance(before, CornerLabels):
                here = np.isin(before.ids, label.ids)
                change += float(np.abs(label.pixels - before.pixels[here]).sum())
            elif isinstance(label, PointLabels) and isinstance(before, PointLabels):
                change += float(np.abs(label.points - before.points).sum())
    change += sum(float(np.abs(T - base.told.transforms[edge]).sum()) for edge, T in scene.told.transforms.items())
    for name in scene.cameras:
        now_camera, was_camera = scene.told.sensors[name].camera, base.told.sensors[name].camera
        assert now_camera
        assert was_camera
        change += abs(now_camera.fx - was_camera.fx)
        change += float(np.abs(now_camera.distortion.coefficients - was_camera.distortion.coefficients).sum())
    return change + float(np.abs(scene.pattern.corners - base.pattern.corners).sum())


def test_a_flipped_axis_turns_the_joint_the_other_way() -> None:
    base, zero = clean("exact", "riwbot", 0), at_zero("riwbot")
    flipped = Case("flipped axis", "exact", "riwbot", 2, 0).scene()
    for edge in moving_edges(base):
        turned = inverse(zero[edge]) @ base.told.transforms[edge]
        np.testing.assert_allclose(inverse(zero[edge]) @ flipped.told.transforms[edge], inverse(turned), atol=1e-12)


def test_states_of_the_collection_before_are_those_of_all_joints() -> None:
    base, stale = clean("exact", "spjbot", 0), Case("stale states", "exact", "spjbot", 0, 0).scene()
    for edge in moving_edges(base):
        np.testing.assert_allclose(stale.told.transforms[edge][1:], base.told.transforms[edge][:-1], atol=1e-12)


def test_joints_that_nearly_cancel_leave_the_hand_turned_as_it_is() -> None:
    base, off = clean("exact", "riwbot", 0), Case("cancelling joints", "exact", "riwbot", 2, 0).scene()
    first, last = moving_edges(base)[0][0], moving_edges(base)[-1][1]
    was, now = base.world.transform(first, last), off.world.transform(first, last)
    np.testing.assert_allclose(now[:, :3, :3], was[:, :3, :3], atol=1e-3)
    assert np.linalg.norm((now - was)[:, :3, 3], axis=-1).min() > 1e-3


def test_a_users_recording_keeps_to_its_conditions() -> None:
    near = recording("riwbot", 1, 1, conditions=Conditions(6, 0.6, noise_px=0.5, at_random=True))
    far = recording("riwbot", 1, 1, conditions=Conditions(6, 1.2, at_random=True))
    assert len(near.told.collections) == 6
    apart = [np.linalg.norm(scene.pose("rgb_world")[:, :3, 3], axis=-1).mean() for scene in (near, far)]
    assert apart[0] < 0.7 * apart[1]
    label = near.told.collections[0].labels["pattern_1", "rgb_world"]
    assert isinstance(label, CornerLabels)
    assert np.std(label.pixels - near.expected(0, "rgb_world", label.ids)) > 0.35


def test_a_defect_by_which_a_variance_grows_without_bound_has_a_verdict() -> None:
    assert run(Case("eccentric gear", "good", "spjbot", 2, 0, limits=False)).red
