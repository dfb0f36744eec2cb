"""Datasets that hold only what has changed: they read as the whole one, and lead nowhere else."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from calibration.base import InputError
from calibration.engine.dataset.model import Dataset
from calibration.engine.dataset.reading import read_dataset
from calibration.engine.dataset.writing import DatasetWriter, write_dataset
from calibration.engine.geometry.transforms import retract
from tests.engine.dataset import documents, test_joints
from tests.engine.dataset.test_writing import assert_equal, calibrated


@pytest.fixture(params=[documents.document, documents.version_2, test_joints.document])
def dataset(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Dataset:
    """A dataset in the folder ``in`` of the working folder."""
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return read_dataset(documents.write(Path("in").resolve(), request.param()))


def moved(dataset: Dataset) -> Dataset:
    """A dataset with everything changed that a calibration may change."""
    found = calibrated(dataset)
    if dataset.joints:
        found = found.with_joints({name: joint.values + 0.01 for name, joint in dataset.joints.items()})
    cameras = {name: s.camera for name, s in dataset.sensors.items() if s.camera is not None}
    return found.with_cameras({name: each.with_intrinsics(each.intrinsics * 1.01) for name, each in cameras.items()})


def write(dataset: Dataset, given: Dataset, path: Path) -> Path:
    """Write the changes of a dataset."""
    return DatasetWriter(given).write_text(DatasetWriter(given).changes_text(dataset), path)


def test_it_reads_as_the_whole_dataset_wherever_the_file_lies(dataset: Dataset, tmp_path: Path) -> None:
    for number, each in enumerate((dataset, moved(dataset), calibrated(dataset, scale=0.2))):
        whole = read_dataset(write_dataset(each, tmp_path / f"whole-{number}"))
        changes = write(each, dataset, tmp_path / "elsewhere" / str(number))
        again = read_dataset(changes.parent)
        assert_equal(whole, again)
        assert again.path.resolve() == dataset.path.resolve()
        for name, joint in whole.joints.items():
            np.testing.assert_array_equal(again.joints[name].values, joint.values)
        assert changes.stat().st_size < write_dataset(each, tmp_path / f"size-{number}").stat().st_size


def test_what_was_read_can_be_written_in_full(dataset: Dataset, tmp_path: Path) -> None:
    result = moved(dataset)
    again = read_dataset(write(result, dataset, tmp_path / "changes"))
    one, other = (write_dataset(each, tmp_path / name) for name, each in (("a", result), ("b", again)))
    assert_equal(read_dataset(one), read_dataset(other))


def test_a_transform_may_be_taken_away_in_a_collection(dataset: Dataset, tmp_path: Path) -> None:
    name = next(iter(dataset.patterns))
    edge = (dataset.patterns[name].parent_link, dataset.patterns[name].link)
    T = np.array(retract(np.broadcast_to(np.eye(4), (len(dataset.keys), 4, 4)), np.full((len(dataset.keys), 6), 0.1)))
    T[-1] = np.nan
    given = read_dataset(write_dataset(calibrated(dataset), Path("given").resolve()))
    again = read_dataset(write(given.with_transforms({edge: T}), given, tmp_path / "changes"))
    assert np.isnan(again.transforms[edge][-1]).all()
    np.testing.assert_allclose(again.transforms[edge][:-1], T[:-1], atol=1e-14)


def test_the_dataset_may_be_named(dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    changes = write(moved(dataset), dataset, tmp_path / "changes")
    whole = read_dataset(write_dataset(moved(dataset), tmp_path / "whole"))
    dataset.path.parent.rename(tmp_path / "other")
    monkeypatch.chdir(tmp_path / "changes")
    for given in (tmp_path / "other", tmp_path / "other" / "dataset.json"):
        assert_equal(read_dataset(changes, given=given), whole)


def refused(changes: Path, given: Path | None = None) -> str:
    """The message without the file."""
    with pytest.raises(InputError) as error:
        read_dataset(changes, given=given)
    file, _, message = str(error.value).partition(": ")
    assert file == str(changes)
    return message


def test_it_leads_nowhere_outside_of_the_working_folder(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = write(moved(dataset), dataset, tmp_path / "changes")
    outside, document = tmp_path / "outside.json", json.loads(changes.read_text())
    dataset.path.rename(outside)
    Path("link.json").symlink_to(outside)
    for there in (True, False):
        for of in (str(outside), "../outside.json", "in/../../outside.json", "link.json", "/dev/stdin"):
            document["changes"]["of"] = of
            changes.write_text(json.dumps(document))
            said = refused(changes)
            assert "the dataset that was calibrated is not below" in said
            assert "datasets: full" in said
        if there:  # the message is the same without it
            outside.unlink()
    monkeypatch.chdir(tmp_path)
    document["changes"]["of"] = "outside.json"
    changes.write_text(json.dumps(document))
    assert "there is no" in refused(changes)


def test_the_dataset_must_be_the_very_one(dataset: Dataset, tmp_path: Path) -> None:
    changes = write(moved(dataset), dataset, tmp_path / "changes")
    secret = Path("secret.json")
    secret.write_text('{"password": "1234"}')
    said = refused(changes, secret)
    assert "is not the dataset that was calibrated, or has changed since" in said
    assert "1234" not in said
    dataset.path.write_text(dataset.path.read_text() + "\n")
    assert "is not the dataset that was calibrated, or has changed since" in refused(changes)
    dataset.path.unlink()
    assert "bring it there, or calibrate with datasets: full" in refused(changes)


def test_changes_of_changes(dataset: Dataset, tmp_path: Path) -> None:
    changes = write(moved(dataset), dataset, Path("changes").resolve())
    document = json.loads(changes.read_text())
    again = tmp_path / "again.json"
    document["changes"] |= {"of": "changes/dataset.json", "sha256": _hash(changes)}
    again.write_text(json.dumps(document))
    assert "holds only changes itself, expected a whole dataset" in refused(again)


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("of",), 1, "changes/of: found 1, expected text"),
        (("of",), "a\0b", "changes/of: the dataset that was calibrated is not below"),
        (("sha256",), None, "changes/sha256: found null, expected text"),
        (("collections",), [], "changes/collections: found an empty list, expected an object"),
        (("collections",), {"77": {"transforms": {}}}, "changes/collections: found collection '77', which"),
        (("transforms",), {"a-b": {"parent": "a"}}, "changes/transforms/a-b: missing key 'child'"),
        (("sensors",), {"nobody": {"camera_info": {}}}, "missing key 'nobody'"),
        (("joints",), {"none": {"x": 1}}, "missing key 'none'"),
    ],
)
def test_what_is_wrong_is_named(
    place: tuple[str], value: object, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = read_dataset(documents.write(tmp_path / "in", test_joints.document()))
    changes = write(moved(given), given, tmp_path / "changes")
    document = json.loads(changes.read_text())
    document["changes"][place[0]] = value
    changes.write_text(json.dumps(document))
    with pytest.raises(InputError, match=message.replace("(", r"\(")):
        read_dataset(changes)


def test_a_key_that_is_not_the_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = read_dataset(documents.write(tmp_path / "in", documents.document()))
    changes = write(moved(given), given, tmp_path / "changes")
    document = json.loads(changes.read_text())
    [(key, entry), *_] = document["changes"]["transforms"].items()
    document["changes"]["transforms"] = {f"{key}-x": entry}
    changes.write_text(json.dumps(document))
    assert "its frames are not those of its key" in refused(changes)
