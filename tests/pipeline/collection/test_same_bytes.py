"""A collection makes the same bytes on processors of other kinds, whose vectors are wider or narrower."""

import hashlib
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from calibration.pipeline.collection.collecting import collect_dataset
from calibration.pipeline.collection.request import CollectionRequest
from tests.pipeline.systems import with_depth_camera, with_scanner
from tests.processors import on_a_lesser_processor, on_linux
from tests.thorough import thorough

SEED = 2
"""Of points that fall next to the border of a pixel's sixteenth, where another last bit shows."""


def digests(describe: Callable[[Path], Path]) -> dict[str, str]:
    """Of each file of a collection: images, clouds, labels, the picture of what was seen, the numbers of the proof."""
    with tempfile.TemporaryDirectory() as folder:
        system, output = Path(folder) / "system", Path(folder) / "output"
        system.mkdir()
        collect_dataset(CollectionRequest(describe(system), motion="generate:5", seed=SEED), output)
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(output.iterdir())}


@pytest.mark.thorough
@on_linux
@pytest.mark.parametrize("describe", [thorough(with_depth_camera), with_scanner])
def test_a_lesser_processor_makes_the_same_files(describe: Callable[[Path], Path]) -> None:
    there = on_a_lesser_processor(__name__, f"digests(module.{describe.__name__})")
    assert there == str(digests(describe))
