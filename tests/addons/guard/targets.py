"""References of cameras and files of datasets, fuzzed by `tests.campaigns`."""

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from calibration.addons.guard.features import REFERENCE_FILE, Reference, read_reference
from calibration.addons.guard.lerobot_check import (
    DatasetCalibration,
    camera_of_dataset,
    read_dataset_calibration,
)
from calibration.addons.guard.lerobot_episodes import INFO, episodes_of
from calibration.base.records import text_of
from tests.addons.guard.recorded import reference
from tests.addons.guard.tiny_datasets import KEY, info_of_dataset
from tests.addons.guard.witness.moving_bag import CAMERA, accepted_cameras
from tests.campaigns.target import Target


def _dataset_calibration() -> list[bytes]:
    camera = camera_of_dataset("hand", CAMERA, accepted_cameras(), pose_column="hand")
    return [text_of(DatasetCalibration(1, {KEY: camera}, {"episode 0": {KEY: "unmoved"}})).encode()]


def _read_info(path: Path) -> object:
    """Read the episodes of a dataset with this info.json."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "meta").mkdir()
        shutil.copy(path, Path(folder) / INFO)
        (Path(folder) / "meta" / "episodes.jsonl").write_text('{"episode_index": 0, "length": 9}')
        return episodes_of(Path(folder), 10)


TARGETS = {
    "reference": Target(REFERENCE_FILE, lambda: [Reference(1, (reference(),)).text.encode()], read_reference, 5),
    "dataset-calibration": Target("calibration.json", _dataset_calibration, read_dataset_calibration, 5),
    "dataset-info": Target("info.json", lambda: [info_of_dataset("v2.1", 2, KEY, (240, 320)).encode()], _read_info, 5),
}
"""By name."""
