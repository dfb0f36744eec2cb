"""The example without an account: one command, on an emulated AWS Batch, in real containers."""

import json
from pathlib import Path

import pytest

from tests.addons.aws_batch import example


@pytest.mark.thorough
def test_scenarios_run_without_an_account(
    tools_image: str, small: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["--image", tools_image, "--system", str(small), "--scenarios", "2", "--output", str(tmp_path / "out")]
    code = example.main(words)
    said = capfd.readouterr().out
    assert said.startswith("EMULATED AWS at http://")
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert code == (0 if results["verdict"] == "pass" else 1)
    assert sorted(path.name for path in (tmp_path / "out" / "scenarios").iterdir() if path.is_dir())[0] == "s1-00000"
