import threading

import pytest

from calibration.ci.workflow import Runner, annotate
from calibration.ci.workflow.runner import Annotation
from calibration.ci.workflow.streams import MAX_LINE_CHARACTERS, MAX_SHOWN_CHARACTERS, LogDisplay, tame
from tests.ci.workflow.conftest import printed
from tests.ci.workflow.test_groups import obeyed


def shown(log: str) -> list[str]:
    """Return what a reader sees: without tokens and empty lines."""
    return [
        line
        for line in log.splitlines()
        if line
        and not line.startswith(("::stop-commands", "::endgroup"))
        and not (line.startswith("::") and line.endswith("::") and len(line) == 36)
    ]


def test_off_github_each_line_names_its_program(laptop: Runner) -> None:
    display = LogDisplay(laptop)
    a, b = display.open("job/a"), display.open("job/b\x1b[2J", live=False)
    a.line("one")
    b.line("two")
    a.line("three")
    a.close()
    b.line("four")
    b.close()
    assert printed(laptop) == "job/a | one\njob/b\\x1b[2J | two\njob/a | three\njob/b\\x1b[2J | four\n"


def test_on_github_one_group_is_open_and_the_others_follow(github: Runner) -> None:
    display = LogDisplay(github)
    essential, other = display.open("job/essential"), display.open("job/other", live=False)
    second = display.open("job2/essential")
    other.line("o1")
    assert printed(github) == ""  # the place is kept for one that is essential
    essential.line("e1")
    second.line("s1")
    essential.line("e2")
    other.close()
    assert shown(printed(github)) == ["::group::job/essential", "e1", "e2"]
    essential.close()
    assert shown(printed(github))[3:] == ["::group::job/other", "o1", "::group::job2/essential", "s1"]
    second.line("s2")
    second.close()
    assert shown(printed(github))[6:] == ["s1", "s2"]
    assert obeyed(printed(github)) == [
        "::group::job/essential",
        "::endgroup::",
        "::group::job/other",
        "::endgroup::",
        "::group::job2/essential",
        "::endgroup::",
    ]


def test_what_programs_print_commands_nothing(github: Runner) -> None:
    display = LogDisplay(github)
    stream = display.open("a")
    for line in ("::error::no", "::endgroup::", "::stop-commands::x", "::x::", "##[error]no", "a\n::error::no"):
        stream.line(line)
    stream.close()
    assert obeyed(printed(github)) == ["::group::a", "::endgroup::"]
    assert "##[" not in printed(github)


def test_others_can_command_while_it_is_paused(github: Runner) -> None:
    display = LogDisplay(github)
    stream = display.open("a")
    stream.line("one")
    with display.paused():
        stream.line("two")
        annotate(github, [Annotation("yes")])
    stream.close()
    assert obeyed(printed(github)) == [
        "::group::a",
        "::endgroup::",
        "::error::yes",
        "::group::a (continued)",
        "::endgroup::",
    ]
    assert shown(printed(github)) == ["::group::a", "one", "::error::yes", "::group::a (continued)", "two"]


def test_nothing_is_said_of_programs_that_say_nothing(github: Runner) -> None:
    LogDisplay(github).open("a").close()
    assert printed(github) == ""


@pytest.mark.parametrize(
    ("line", "tamed"),
    [
        ("\x1b[1;31mred\x1b[0m", "red"),
        ("10%\r20%\r30%", "30%"),
        ("text\r", "text"),
        ("    indented", "    indented"),
        ("\tx", "    x"),
        ("bell\x07", "bell\\x07"),
        ("\x1b]0;title\x07text", "text"),
        ("x" * 5000, "x" * (MAX_LINE_CHARACTERS - 1) + "…"),
        ("", ""),
        (" " * 9999 + "x", " " * 500 + "x"),
    ],
)
def test_tamed(line: str, tamed: str) -> None:
    assert tame(line) == tamed


def test_too_much_is_cut_and_said(laptop: Runner) -> None:
    display = LogDisplay(laptop)
    stream = display.open("a")
    for _ in range(MAX_SHOWN_CHARACTERS // MAX_LINE_CHARACTERS + 100):
        stream.line("x" * MAX_LINE_CHARACTERS)
    lines = printed(laptop).splitlines()
    assert lines[-1] == "a | (more is not shown here, see the file of the log)"
    assert len(lines) < MAX_SHOWN_CHARACTERS // MAX_LINE_CHARACTERS + 5


def test_a_reader_that_is_gone_stops_nobody(laptop: Runner) -> None:
    laptop.stdout.close()
    display = LogDisplay(laptop)
    stream = display.open("a")
    stream.line("one")
    stream.line("two")
    with display.paused():
        stream.close()


def test_many_threads_lose_no_line(github: Runner) -> None:
    display = LogDisplay(github)

    def write(number: int) -> None:
        stream = display.open(f"s{number}")
        for i in range(200):
            stream.line(f"{number}-{i}")
        stream.close()

    threads = [threading.Thread(target=write, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for _ in range(20):
        with display.paused():
            pass
    for thread in threads:
        thread.join()
    lines = [line for line in shown(printed(github)) if not line.startswith("::")]
    for number in range(4):
        assert [line for line in lines if line.startswith(f"{number}-")] == [f"{number}-{i}" for i in range(200)]
    assert len(obeyed(printed(github))) % 2 == 0
