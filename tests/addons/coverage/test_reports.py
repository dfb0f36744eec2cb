"""Reports of other tools: parsed, or refused in one line if they are malformed."""

from collections.abc import Callable
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.addons.coverage.formats import FileCoverage, Rate, parse_cobertura, parse_lcov, tracefile
from calibration.base import InputError
from calibration.ci.report.junit import CaseOutcome, Tally, read_test_report

COBERTURA = """<?xml version="1.0" ?>
<!DOCTYPE coverage SYSTEM "http://cobertura.sourceforge.net/xml/coverage-04.dtd">
<coverage version="7.4" line-rate="0.6" branch-rate="0.5">
  <sources><source>/build/src</source><source> </source></sources>
  <packages><package name="robot"><classes>
    <class name="naming" filename="robot/naming.py">
      <methods><method name="f"><lines><line number="1" hits="9"/></lines></method></methods>
      <lines><line number="1" hits="2"/><line number="2" hits="0"/>
        <line number="3" hits="1" branch="true" condition-coverage="50% (1/2)" missing-branches="4"/></lines>
    </class>
    <class name="inner" filename="robot/naming.py"><lines><line number="2" hits="3"/>
        <line number="3" hits="1" branch="true" condition-coverage="100% (2/2)"/></lines></class>
    <class name="empty" filename="robot/__init__.py"><methods/><lines/></class>
  </classes></package></packages>
</coverage>"""


def cobertura(lines: str) -> bytes:
    classes = f'<class filename="a.py"><lines>{lines}</lines></class>'
    return f'<coverage line-rate="1"><classes>{classes}</classes></coverage>'.encode()


def test_cobertura() -> None:
    report = parse_cobertura(COBERTURA.encode(), "c.xml")
    assert report.folders == ("/build/src",)
    assert report.files == {
        "robot/naming.py": FileCoverage({1: 2, 2: 3, 3: 2}, {3: Rate(2, 2)}, {(1, 1): 9}),
        "robot/__init__.py": FileCoverage(),
    }


LINES = st.integers(1, 10_000_000)
RATES = st.integers(1, 20).flatmap(lambda total: st.builds(Rate, st.integers(0, total), st.just(total)))


@given(
    st.dictionaries(
        st.text(st.characters(exclude_categories=["Cc", "Z", "Cs"]), min_size=1),
        st.builds(
            FileCoverage,
            st.dictionaries(LINES, st.integers(0, 2**63 - 1)),
            st.dictionaries(LINES, RATES, max_size=5),
            st.dictionaries(st.tuples(LINES, LINES), st.integers(0, 2**63 - 1), max_size=3),
        ),
        min_size=1,
        max_size=3,
    )
)
def test_a_tracefile_is_read_as_it_was_written(files: dict[str, FileCoverage]) -> None:
    assert parse_lcov(tracefile(files).encode(), "lcov.info").files == files


def test_a_name_that_a_tracefile_cannot_hold_is_left_out() -> None:
    assert "x" not in tracefile({"a\nSF:x": FileCoverage({1: 1}), " x": FileCoverage(), "b": FileCoverage({1: 1})})


def test_cobertura_in_another_encoding() -> None:
    text = COBERTURA.replace('version="1.0" ?', 'version="1.0" encoding="utf-16"?').replace("naming", "näming")
    assert "robot/näming.py" in parse_cobertura(text.encode("utf-16"), "c.xml").files


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"<coverage", "c.xml: this is not valid XML: unclosed token"),
        (b"<report/>", "c.xml: found XML with the root <report>, expected Cobertura: <coverage line-rate=...>"),
        (b"<coverage generated='1'/>", "root <coverage>, expected Cobertura"),  # Clover
        (b"<coverage line-rate='1'><class/></coverage>", "c.xml: a class has no filename"),
        (cobertura('<line number="1"/>'), "c.xml: a.py:1: hits is nothing, a whole number from 0 to "),
        (cobertura('<line number="1" hits="NaN"/>'), "c.xml: a.py:1: hits is 'NaN', a whole number from 0"),
        (cobertura('<line number="1" hits="-1"/>'), "hits is '-1'"),
        (cobertura('<line number="1" hits="99999999999999999999"/>'), "hits is '99999999999999999999'"),
        (cobertura('<line number="0" hits="1"/>'), "a.py: number is '0', a whole number from 1 to 10000000 was"),
        (cobertura('<line number="\u0661" hits="1"/>'), "number is '\u0661'"),
        (cobertura('<line number="1" hits="1" branch="true" condition-coverage="(3/2)"/>'), "such as 50% (1/2)"),
        (cobertura('<line number="1" hits="1" branch="true" condition-coverage="150% (3/2)"/>'), "such as 50% (1/2)"),
        (b"<coverage line-rate='1'>" + b"<a>" * 200, "nested more than 100 deep"),
        (b'<?xml version="1.0" encoding="no-such"?><coverage line-rate="1"/>', "not valid XML"),
    ],
)
def test_what_is_no_cobertura(data: bytes, message: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_cobertura(data, "c.xml")
    assert message in str(refused.value)
    assert len(str(refused.value)) < 500


BILLION = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10 if i else "lol"}">' for i in range(12))
ENTITIES = [
    '<!DOCTYPE coverage [<!ENTITY x SYSTEM "file:///etc/passwd">]><coverage line-rate="1">&x;</coverage>',
    f'<!DOCTYPE coverage [{BILLION}]><coverage line-rate="1">&l11;</coverage>',
    '<!DOCTYPE coverage [<!ENTITY % x SYSTEM "http://127.0.0.1:9/x.dtd"> %x;]><coverage line-rate="1"/>',
]


@pytest.mark.parametrize("parse", [parse_cobertura, read_test_report])
@pytest.mark.parametrize("text", ENTITIES)
def test_entities_are_refused(parse: Callable[[bytes, str], object], text: str) -> None:
    with pytest.raises(InputError, match=r"evil.xml: the XML declares entities"):
        parse(text.encode(), "evil.xml")


def test_a_large_report_is_read_without_holding_it_all() -> None:
    import tracemalloc

    lines = "".join(f'<line number="{1 + i % 50}" hits="1"/>' for i in range(25_000)).encode()
    data = cobertura("").replace(b"</lines>", lines + b"</lines>")
    tracemalloc.start()
    report = parse_cobertura(data, "c.xml")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert report.files["a.py"].hits == dict.fromkeys(range(1, 51), 500)
    assert peak < 4 * len(data)


LCOV = b"""TN:unit
SF:src/arm.cpp
FN:3,move
FNDA:2,move
DA:3,2
DA:4,0,checksum
BRDA:3,0,0,1
BRDA:3,0,1,-
LF:2
LH:1
end_of_record
TN:other
SF:src/arm.cpp\r
DA:4,1
DA:5,0
BRDA:3,0,1,0
BRDA:5,e0,1,4
end_of_record
SF:src/empty.cpp
end_of_record
"""


def test_lcov() -> None:
    report = parse_lcov(LCOV, "lcov.info")
    arm = FileCoverage({3: 2, 4: 1, 5: 0}, {3: Rate(1, 2), 5: Rate(1, 1)}, {(3, 5): 2})
    assert report.files == {"src/arm.cpp": arm, "src/empty.cpp": FileCoverage()}
    assert report.folders == ()


def test_lcov_whose_branches_are_seen_by_different_tests() -> None:
    record = "SF:a.c\nBRDA:1,0,0,{}\nBRDA:1,0,1,{}\nend_of_record\n"
    report = parse_lcov((record.format(1, "-") + record.format(0, 7)).encode(), "lcov.info")
    assert report.files["a.c"].branches == {1: Rate(2, 2)}


@pytest.mark.parametrize(
    ("lines", "functions"),
    [
        ("FN:1,a\nFN:5,b\nFNDA:3,a\nDA:9,0\n", {(1, 4): 3, (5, 9): 0}),  # each ends before the next
        ("FN:1,2,a\nFNDA:3,a\nFNDA:4,a\n", {(1, 2): 7}),  # as LCOV 2 and coverage.py write it
        ("FN:1,f(int, int)\nFN:1,f<a>\nFNDA:1,f(int, int)\nFNDA:1,f<a>\n", {(1, 1): 2}),  # instances of a template
        ("FN:x,a\nFNDA:-1,a\nFN:2\n", {}),
    ],
)
def test_functions_of_lcov(lines: str, functions: dict[tuple[int, int], int]) -> None:
    report = parse_lcov(f"SF:a.cpp\n{lines}end_of_record\n".encode(), "lcov.info")
    assert report.files["a.cpp"].functions == functions


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("TN:x\n", "l.info: no file is named in it (SF:...)"),
        ("SF:a.c\nDA:1,1\n", "l.info: it ends in the middle of a record"),
        ("SF:a.c\nSF:b.c\n", "l.info:2: a record begins before the last one ended"),
        ("DA:1,1\n", "l.info:1: DA precedes the file"),
        ("SF: \n", "l.info:1: SF names no file"),
        ("SF:a.c\nDA:1,-3\nend_of_record", "l.info:2: found DA:1,-3, expected DA:line,hits"),
        ("SF:a.c\nDA:1,nan\nend_of_record", "found DA:1,nan"),
        ("SF:a.c\nDA:0,1\nend_of_record", "found DA:0,1"),
        ("SF:a.c\nDA:99999999,1\nend_of_record", "found DA:99999999,1"),
        ("SF:a.c\nBRDA:1,0,1\nend_of_record", "expected BRDA:line,block,branch,taken"),
    ],
)
def test_what_is_no_lcov(text: str, message: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_lcov(text.encode(), "l.info")
    assert message in str(refused.value)


@given(st.dictionaries(st.integers(1, 10**6), st.integers(0, 10**12), min_size=1))
def test_lcov_and_cobertura_say_the_same(hits: dict[int, int]) -> None:
    lcov = "SF:a.py\n" + "".join(f"DA:{line},{count}\n" for line, count in hits.items()) + "end_of_record\n"
    xml = "".join(f'<line number="{line}" hits="{count}"/>' for line, count in hits.items())
    assert parse_lcov(lcov.encode(), "l").files == parse_cobertura(cobertura(xml), "c").files
    assert parse_lcov(lcov.encode(), "l").files["a.py"].hits == hits


@pytest.mark.parametrize("parse", [parse_lcov, parse_cobertura, read_test_report])
@given(st.binary(max_size=200))
def test_bytes_of_any_kind_are_read_or_refused(parse: Callable[[bytes, str], object], data: bytes) -> None:
    with suppress(InputError):
        parse(data, "x")


JUNIT = b"""<?xml version="1.0" encoding="utf-8"?>
<testsuites><testsuite name="pytest" tests="6">
<testcase classname="tests.test_a" name="test_one" file="tests/test_a.py" line="4" time="0.1"/>
<testcase classname="tests.test_a" name="test_two" file="tests/test_a.py" line="8">
  <failure message="assert 1 == 2&#10;::error::evil">long</failure></testcase>
<testcase classname="tests.test_a" name="test_two" file="tests/test_a.py" line="8"><error message="x"/></testcase>
<testcase classname="" name="tests.test_b"><error>no module\nnamed x</error></testcase>
<testcase name="test_skip"><skipped type="pytest.skip" message="x"/></testcase>
<testcase name="test_xfail"><skipped type="pytest.xfail" message="x"/></testcase>
</testsuite></testsuites>"""


def test_junit() -> None:
    assert Tally.of(read_test_report(JUNIT, "t.xml")) == Tally(
        passed=2,
        failed=2,
        skipped=1,
        failures=(
            CaseOutcome("tests.test_a.test_two", "assert 1 == 2 ::error::evil", "tests/test_a.py", 9),
            CaseOutcome("tests.test_b", "no module named x"),
        ),
    )


def test_what_is_no_junit() -> None:
    with pytest.raises(InputError, match=r"t.xml: found XML with the root <html>, expected JUnit or CTest"):
        read_test_report(b"<html/>", "t.xml")
