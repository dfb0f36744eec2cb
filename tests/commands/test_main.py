import ctypes
import os
import resource
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import click
import cv2
import numpy as np
import pytest

from calibration import __main__ as entry
from calibration.__main__ import COMMANDS, main, run_action
from calibration.base import ExitCode, InfrastructureError, InputError, UndeterminedError
from calibration.base.addons import LazyCommand
from calibration.commands import parameters
from tests.repositories import needs_git


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Isolate the command from the tests' own runner, and tests from settings of each other."""
    for name in [name for name in os.environ if name.startswith(("GITHUB_", "INPUT_", "RUNNER_"))]:
        monkeypatch.delenv(name)
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        monkeypatch.setenv(name, "1")


def explode(error: BaseException) -> None:
    raise error


@pytest.fixture
def ends_with(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Add a command ``end`` to the list, which returns, or raises, the first item of this list."""
    ends: list[object] = []

    @click.command("end")
    @click.option("--every-min", type=parameters.number)
    @parameters.boolean_option("--exclusive", help="...")
    @click.option("--names", type=parameters.TEXT_LIST)
    def end(every_min: float | None, exclusive: bool, names: tuple[str, ...] | None) -> object:
        if not ends:
            ends.append((every_min, exclusive, names))
        result = ends[0]
        return explode(result) if isinstance(result, BaseException) else 0 if isinstance(result, tuple) else result

    monkeypatch.setattr(entry, "end", end, raising=False)
    monkeypatch.setattr(entry, "COMMANDS", {**COMMANDS, "end": LazyCommand("calibration.__main__:end", "End.")})
    return ends


def calibration(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("GITHUB_")} | variables
    return subprocess.run(
        [sys.executable, "-m", "calibration", *arguments], capture_output=True, text=True, env=environment, timeout=60
    )


def test_help_lists_the_commands_that_are_there() -> None:
    done = calibration("--help")
    assert done.returncode == 0
    assert done.stderr == ""
    assert "introspect-csv" in done.stdout
    assert "version" in done.stdout
    assert "0 pass, 1 the verdict is fail, 2 bad input, 3 infrastructure failed" in " ".join(done.stdout.split())


def test_a_command_that_is_not_installed_is_not_listed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        entry, "COMMANDS", {**COMMANDS, "ghost": LazyCommand("calibration.commands.ghost:command", "!")}
    )
    assert main(["--help"]) == 0
    assert "ghost" not in capsys.readouterr().out
    assert main(["ghost"]) == 2
    assert capsys.readouterr().err.startswith("error: there is no command 'ghost'")


def test_every_command_that_is_there_can_be_loaded() -> None:
    context = click.Context(entry.group)
    for name in entry.group.list_commands(context):
        command = entry.group.get_command(context, name)
        assert command is not None
        assert command.name == name


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["introspect-csv", "--help"], ["nonsense"]])
def test_nothing_heavy_is_imported(arguments: list[str]) -> None:
    script = (
        "import sys; from calibration.__main__ import main; main(sys.argv[1:]);"
        "heavy = {'numpy', 'scipy', 'cv2', 'rich', 'jsonschema', 'yaml', 'docker', 'boto3'};"
        "heavy &= set(sys.modules);"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_version() -> None:
    assert calibration("--version").stdout.startswith("calibration-ci ")
    lines = calibration("version").stdout.splitlines()
    assert lines[0].startswith("calibration-ci ")
    assert lines[1].startswith("python 3.")
    assert any(line.startswith("numpy ") for line in lines)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "error: Missing command (see calibration --help)"),
        (["introspct-csv"], "error: there is no command 'introspct-csv': did you mean 'introspect-csv'?"),
        (["qqq"], "error: there is no command 'qqq' (see calibration --help)"),
        (["--nonsense"], "error: No such option"),
        (["introspect-csv", "--fil", "x"], "error: No such option"),
        (["introspect-csv", "stray"], "error: Got unexpected extra argument (stray)"),
        (["end", "--every-min", "x"], "error: Invalid value for '--every-min': 'x' is not a finite number"),
        (["end", "--every-min", ""], "error: Invalid value for '--every-min': '' is not a finite number"),
        (["end", "--every-min"], "error: Option '--every-min' requires an argument"),
        (
            ["end", "--exclusive", "perhaps"],
            "error: Invalid value for '--exclusive': 'perhaps' is neither true nor false",
        ),
    ],
)
def test_wrong_usage_is_bad_input_in_one_line(
    ends_with: list[object], capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(message)
    assert err.count("\n") == 1


@pytest.mark.parametrize(("end", "code"), [(None, 0), (ExitCode.PASS, 0), (ExitCode.FAIL, 1), (2, 2)])
def test_the_exit_code_is_the_return_value(ends_with: list[object], end: object, code: int) -> None:
    ends_with.append(end)
    assert main(["end"]) == code


def _caused_by(cause: BaseException) -> Exception:
    error = RuntimeError("a worker ended")
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("a.csv: is\nwrong"), 2, "error: a.csv: is\\nwrong\n"),
        (UndeterminedError("one axis"), 2, "error: one axis\n"),
        (InfrastructureError("disk full"), 3, "error: disk full\n"),
        (
            OSError(28, "No space left"),
            3,
            "error: the output: No space left: free disk space, or choose another path\n",
        ),
        (OSError(28, "No space left", "/x"), 3, "error: /x: No space left: free disk space, or choose another path\n"),
        (KeyboardInterrupt(), 130, "error: stopped by SIGINT\n"),
        (
            ModuleNotFoundError("No module named 'cv2'", name="cv2.x"),
            3,
            "error: the package cv2 is not installed: pip install opencv-python-headless\n",
        ),
    ],
)
@pytest.mark.parametrize("github", [False, True])
def test_errors_are_one_line(
    ends_with: list[object],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    error: BaseException,
    code: int,
    line: str,
    github: bool,
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", str(github).lower())
    ends_with.append(error)
    assert main(["end"]) == code
    out, err = capsys.readouterr()
    assert err == line
    assert out == (line.replace("error: ", "::error::") if github else "")


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize(
    ("arguments", "code"), [("schema", 0), ("calibrate-matrix --dataset none", 2), ("version", 0), ("none", 2)]
)
def test_a_stream_that_the_caller_has_closed(arguments: str, code: int, number: int) -> None:
    command = ["bash", "-c", f'exec {number}>&-; exec "$@"', "bash", sys.executable, "-m", "calibration"]
    done = subprocess.run([*command, *arguments.split()], capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert "Traceback" not in done.stderr
    assert "bug" not in done.stderr
    assert done.stderr.count("\n") == (number == 1 and code == 2)


def test_a_file_takes_no_place_of_a_closed_stream() -> None:
    program = "import os, sys; from calibration.__main__ import main; main(['version'])"
    program += "; sys.exit(os.open('/dev/null', 0) < 3)"
    command = ["bash", "-c", 'exec 1>&- 0<&-; exec "$@"', "bash", sys.executable, "-c", program]
    assert subprocess.run(command, check=False).returncode == 0


def test_warnings_of_packages_stand_beside_no_error(
    ends_with: list[object], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Warns:
        def __int__(self) -> int:
            warnings.warn("overflow encountered", RuntimeWarning, stacklevel=1)
            return 0

    with warnings.catch_warnings():
        warnings.simplefilter("always")
        ends_with.append(Warns())
        assert main(["end"]) == 0
        assert capsys.readouterr().err == ""


@pytest.mark.parametrize("error", [InputError, InfrastructureError, click.UsageError])
@pytest.mark.parametrize("quoted", ["x" * 100_000, "ab " * 30_000, "a/" * 30_000])
def test_quotes_in_errors_are_shortened(
    ends_with: list[object], capsys: pytest.CaptureFixture[str], error: type[Exception], quoted: str
) -> None:
    ends_with.append(error(f"a.json: found '{quoted}', expected a frame"))
    assert main(["end"]) > 1
    err = capsys.readouterr().err
    assert len(err) < 2100
    assert err.startswith("error: a.json: found '")
    assert "', expected a frame" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("character", "\u202e\u2066\u200f\u061c\u200b\ufeff\x1b")
def test_characters_that_mislead_are_shown(
    ends_with: list[object], capsys: pytest.CaptureFixture[str], character: str
) -> None:
    ends_with.append(click.UsageError(f"cam{character}era"))
    assert main(["end"]) == 2
    assert f"cam{character.encode('unicode_escape').decode()}era" in capsys.readouterr().err


def without_the_rights_of_root() -> None:
    """Drop the capabilities by which root reads everything: CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH."""
    for capability in (1, 2):
        ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP


@pytest.mark.parametrize(
    ("arguments", "code", "line"),
    [
        ("introspect-csv --file locked/x.csv --column a --max 1", 2, "locked/x.csv: a CSV file was expected, but it"),
        ("introspect-csv --file locked/*.csv --column a --max 1", 2, "locked/*.csv: the folder locked cannot be read"),
        ("coverage-upload --service none --reports x --directory locked", 2, "locked: this folder cannot be entered:"),
        ("record-motion --system system --output locked/x.json", 3, "locked/x.json: Permission denied: give this user"),
    ],
)
def test_a_folder_that_may_not_be_read_is_named(tmp_path: Path, arguments: str, code: int, line: str) -> None:
    needs_git()
    locked = tmp_path / "locked"
    locked.mkdir()
    locked.chmod(0)
    (tmp_path / "system").symlink_to(Path(__file__).parents[2] / "datasets/t2rgb")
    done = subprocess.run(
        [sys.executable, "-m", "calibration", *arguments.split()],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        capture_output=True,
        text=True,
        preexec_fn=without_the_rights_of_root,
        check=False,
    )
    locked.chmod(0o700)
    [said] = done.stderr.splitlines()
    assert said.startswith(f"error: {line}")
    assert done.returncode == code


@pytest.mark.parametrize(
    "error", [ZeroDivisionError("x"), ModuleNotFoundError("No module named 'calibration.x'", name="calibration.x")]
)
def test_a_bug_shows_its_traceback(
    ends_with: list[object], capsys: pytest.CaptureFixture[str], error: BaseException
) -> None:
    ends_with.append(error)
    assert main(["end"]) == 3
    err = capsys.readouterr().err
    assert err.startswith("Traceback")
    assert err.endswith("error: this is a bug in Calibration CI, please report it with the lines above\n")


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (MemoryError(), 3, "error: there is not enough memory: use fewer collections or processes, or more memory"),
        (
            cv2.error("(-4:Insufficient memory) Failed to allocate"),
            3,
            "error: there is not enough memory",
        ),
        (_caused_by(MemoryError()), 3, "error: there is not enough memory"),
        (np.linalg.LinAlgError("Singular matrix"), 2, "error: the data: found numbers that cannot be solved (Singular"),
    ],
)
def test_expected_errors_are_one_line(
    ends_with: list[object], capsys: pytest.CaptureFixture[str], error: BaseException, code: int, line: str
) -> None:
    ends_with.append(error)
    assert main(["end"]) == code
    [said] = capsys.readouterr().err.splitlines()
    assert said.startswith(line)


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("megabytes", [60, 80, 100, 120, 1000])
def test_too_little_memory_for_numpy_is_no_verdict(megabytes: int) -> None:
    """OpenBLAS ends the process with exit code 1 if its import finds no memory."""
    done = subprocess.run(
        [sys.executable, "-m", "calibration", "calibrate-matrix", "--dataset", "none"],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20, megabytes << 20)),
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    # Whether 120 MB are enough depends on the libraries; in both cases exit code and message must agree.
    assert done.returncode in {60: {3}, 80: {3}, 100: {3}, 120: {2, 3}, 1000: {2}}[megabytes]
    [said] = done.stderr.splitlines()
    assert said.startswith("error: there is not enough memory" if done.returncode == 3 else "error: none: ")


@pytest.mark.thorough(but_first=2)
@pytest.mark.parametrize("arguments", ["version", "schema", "calibrate-matrix --dataset none", "nothing"])
def test_full_streams_are_no_verdict(arguments: str) -> None:
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "calibration", *arguments.split()]
        assert subprocess.run(command, stdout=full, stderr=full, check=False).returncode == 3


def test_a_bugs_message_commands_nothing(
    ends_with: list[object], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    ends_with.append(ValueError("\n::add-mask::x"))
    assert main(["end"]) == 3
    lines = capsys.readouterr().err.splitlines()
    token = lines[0].removeprefix("::stop-commands::")
    assert lines.index("::add-mask::x") < lines.index(f"::{token}::")


def test_an_action_reads_its_inputs(ends_with: list[object], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INPUT_EVERY_MIN", "-1.5")
    monkeypatch.setenv("INPUT_EXCLUSIVE", "Yes")
    monkeypatch.setenv("INPUT_NAMES", "a\nb c\n")
    assert run_action("end") == 0
    assert ends_with == [(-1.5, True, ("a", "b c"))]


def test_an_empty_input_is_none(ends_with: list[object], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("INPUT_EVERY_MIN", "INPUT_EXCLUSIVE", "INPUT_NAMES"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv("INPUT_HELP", "true")
    assert run_action("end") == 0
    assert ends_with == [(None, False, None)]


def test_an_actions_input_can_be_false(ends_with: list[object], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INPUT_EXCLUSIVE", "false")
    assert run_action("end") == 0
    assert ends_with == [(None, False, None)]


def test_a_wrong_input_is_bad_input(
    ends_with: list[object], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("INPUT_EVERY_MIN", "x")
    assert run_action("end") == 2
    line = capsys.readouterr().err
    assert line.startswith("error: Invalid value for '--every-min'")
    assert "'x' is not a finite number" in line
    assert "--help" not in line


def test_the_command_line_reads_no_inputs(ends_with: list[object], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("INPUT_EVERY_MIN", "3")
    monkeypatch.setenv("INPUT_END_EVERY_MIN", "3")
    monkeypatch.setenv("CALIBRATION_END_EVERY_MIN", "3")
    assert main(["end"]) == 0
    assert ends_with == [(None, False, None)]


def test_numpy_has_one_thread_by_default(ends_with: list[object], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "4")
    main(["end"])
    assert os.environ["OMP_NUM_THREADS"] == "1"
    assert os.environ["OPENBLAS_NUM_THREADS"] == "4"


STOPPABLE = """
import sys, time, click
from calibration import __main__ as entry

@click.command("wait")
def wait():
    try:
        print("ready", flush=True)
        time.sleep(60)
    finally:
        print("cleaned", flush=True)

entry.wait = wait
entry.COMMANDS = {"wait": entry.LazyCommand("calibration.__main__:wait", "")}
sys.exit(entry.main(["wait"]))
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_stop_cleanly(number: signal.Signals, code: int) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", STOPPABLE], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "ready\n"
            process.send_signal(number)
            out, err = process.communicate(timeout=50)
        finally:
            process.kill()
    assert process.returncode == code
    assert out == "cleaned\n"
    assert err == f"error: stopped by {number.name}\n"


def test_a_reader_that_goes_away_is_no_verdict(tmp_path: Path) -> None:
    script = "import sys; from calibration.__main__ import main; sys.stdin.readline(); sys.exit(main(['version']))"
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.close()
    process.stdout = None
    _, err = process.communicate("go\n", timeout=60)
    assert process.returncode == 3
    assert err == ""


def test_a_terminal_that_cannot_show_a_character(tmp_path: Path) -> None:
    (tmp_path / "ü.csv").write_text("k,µ\na,1\n")
    done = calibration(
        "introspect-csv", "--file", str(tmp_path / "ü.csv"), "--column", "µ", "--max", "2", PYTHONIOENCODING="ascii"
    )
    assert done.returncode == 0
    assert "\\xfc.csv" in done.stdout


@pytest.mark.parametrize(
    ("words", "proposed"), [("calibration calibrate-m", "calibrate-matrix"), ("calibration run --conf", "--config")]
)
def test_a_shell_completes_commands_and_options(words: str, proposed: str) -> None:
    asked = {"_CALIBRATION_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    command = [sys.executable, "-m", "calibration"]
    done = subprocess.run(command, env={**os.environ, **asked}, capture_output=True, text=True, check=True)
    assert done.stdout == f"plain,{proposed}\n"


def test_a_library_for_which_there_is_no_memory_is_no_bug(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(_: str) -> click.Command:
        raise ImportError("libaom.so.3: failed to map segment from shared object")

    monkeypatch.setattr(entry, "load_command", refuse)
    assert run_action("run") == 3
    assert "there is not enough memory" in "".join(capsys.readouterr())
