import socket
import subprocess
import sys
from pathlib import Path

import pytest

from calibration.__main__ import main
from calibration.addons.recorder import record_motion
from tests.addons.recorder.conftest import DATASETS

T2RGB = ("--system", str(DATASETS / "t2rgb"))


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = main(["record-motion", *arguments])
    return code, capsys.readouterr().err


def test_without_viser_one_line_says_how_to_get_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_motion, "find_spec", lambda _: None)
    code, said = run(capsys, *T2RGB)
    assert code == 3
    assert said == "error: record-motion needs viser: pip install viser\n"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--system", "nothing"), "system: found 'nothing'"),
        ((*T2RGB, "--motion", "nothing.json"), "nothing.json"),
        ((*T2RGB, "--motion", str(DATASETS / "riwbot" / "motion.json")), "position and orientation"),
        ((*T2RGB, "--host", "192.0.2.7", "--port", "0"), "host: found '192.0.2.7'"),
        ((*T2RGB, "--port", "70000"), "port: found 70000, expected a whole number from 0 to 65535"),
        ((*T2RGB, "--port", "-1"), "port: found -1, expected a whole number from 0 to 65535"),
        ((*T2RGB, "--output", "."), "is a folder, expected a file"),
        ((), "--system"),
    ],
)
def test_bad_input_is_said_in_one_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], expected: str
) -> None:
    code, said = run(capsys, *arguments)
    assert code == 2
    assert said.count("\n") == 1
    assert expected in said


def test_a_port_in_use_is_an_infrastructure_error(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        code, said = run(capsys, *T2RGB, "--port", str(taken.getsockname()[1]))
    assert code == 3
    assert "is in use on 127.0.0.1" in said


def test_help_imports_nothing_heavy(tmp_path: Path) -> None:
    program = (
        "import sys; from calibration.__main__ import main; main(['record-motion', '--help']); "
        "sys.exit(sorted({'viser', 'numpy', 'cv2'} & sys.modules.keys()) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "drag the pattern" in done.stdout
