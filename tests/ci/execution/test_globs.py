import glob
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.ci.execution.outcome import Glob


@pytest.mark.parametrize(
    ("path", "source", "inside", "lands"),
    [
        ("/out/a.csv", "/out/a.csv", "", "a.csv"),
        ("/out/data", "/out/data", "x/y.png", "data/x/y.png"),
        ("/out/data/", "/out/data", "x", "data/x"),
        ("/out/*.csv", "/out", "a.csv", "a.csv"),
        ("/out/*.csv", "/out", "d/a.csv", None),
        ("/out/*", "/out", "d/e/f", "d/e/f"),  # a folder includes all its content
        ("/out/*", "/out", ".hidden", None),
        ("/out/.h*", "/out", ".hidden", ".hidden"),
        ("/out/run-?/[ab].csv", "/out", "run-1/a.csv", "run-1/a.csv"),
        ("/out/run-?/[!ab].csv", "/out", "run-1/a.csv", None),
        ("/out/**/*.csv", "/out", "a.csv", "a.csv"),
        ("/out/**/*.csv", "/out", "x/y/a.csv", "x/y/a.csv"),
        ("/out/**/*.csv", "/out", ".git/a.csv", None),
        ("/out/**", "/out", "x/y", "x/y"),
        ("/out/**/z/*.csv", "/out", "z/z/z/a.csv", "z/z/z/a.csv"),
        ("/out/**/z/*.csv", "/out", "y/a.csv", None),
        ("/out/A.csv", "/out/A.csv", "", "A.csv"),
        ("/out/*.CSV", "/out", "a.csv", None),
    ],
)
def test_matches_of_a_pattern(path: str, source: str, inside: str, lands: str | None) -> None:
    pattern = Glob(path)
    assert pattern.source == source
    found = pattern.landing(tuple(part for part in inside.split("/") if part))
    assert (None if found is None else "/".join(found)) == lands


NAMES = st.lists(st.sampled_from(["a", "b", "a.csv", ".a"]), min_size=1, max_size=4)


PARTS = st.lists(st.sampled_from(["**", "?", "a*", "b", "*.csv", "[ab]", ".*"]), max_size=3).filter(
    lambda parts: parts[-1:] != ["**"]  # a final ** matches files here, but only folders in glob
)


@given(PARTS, NAMES)
def test_agrees_with_the_standard_library(parts: list[str], name: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, *name)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
        pattern = "/".join(["*", *parts])
        theirs = glob.glob(pattern, root_dir=folder, recursive=True)  # noqa: PTH207
    named = any(Path(*name).is_relative_to(found) for found in theirs)
    assert (Glob(f"/out/{pattern}").landing(name) is not None) == named


def test_many_stars_take_no_time() -> None:
    assert Glob("/out/" + "**/a/" * 60 + "b").landing(("a",) * 1000) is None
    assert Glob("/out/" + "*a" * 60 + "b").landing(("a" * 200,)) is None
