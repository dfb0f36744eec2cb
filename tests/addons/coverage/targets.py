"""Reports of coverage and tests, fuzzed by `tests.campaigns`."""

from pathlib import Path

from calibration.addons.coverage.pseudo_tested import Recording
from calibration.addons.coverage.reading import read_reports
from calibration.addons.coverage.sources import Sources, functions_of
from calibration.ci.git import Repository
from calibration.ci.report.junit import read_test_report
from tests.campaigns.target import Target, files_of

RECORD = b"""["entered", 0, null]
["context", "fixture f of tests", ["a", "b"]]
["entered", 1, "fixture f of tests"]
["arguments", 1, ["builtins.int"]]
["gave", 1, "builtins.tuple", ["(0, )", "(1, )"], "(2, )"]
["outcome", "a", "passed", 0.25]
"""
LCOV = b"TN:\nSF:a.py\nDA:1,1\nDA:2,0\nBRDA:2,0,0,1\nLF:2\nLH:1\nend_of_record\n"
COBERTURA = (
    b'<?xml version="1.0"?><coverage line-rate="0.5"><sources><source>.</source></sources><packages><package name="p">'
    b'<classes><class name="a" filename="a.py"><lines><line number="1" hits="1"/><line number="2" hits="0"/></lines>'
    b"</class></classes></package></packages></coverage>"
)


def _covered(path: Path) -> None:
    source = path.with_name("a.py")
    source.write_text("x = 1\ny = 2\n")
    sources = Sources(Repository(path.parent), path.parent, (), ("a.py",), ("a.py",))
    read_reports([path], sources, {}, path.parent / "meanwhile")


def _recorded(path: Path) -> None:
    recording = Recording()
    recording.read(path, ["a", "b"])
    [function] = functions_of("a.py", b"def f(x):\n    return x + 1\n")
    for number in range(2):
        recording.replacements(number, function)


TARGETS = {
    "junit": Target(
        "junit.xml", files_of("datasets/*/junit.xml"), lambda path: read_test_report(path.read_bytes(), "junit.xml"), 4
    ),
    "pseudo-tested": Target("record", lambda: [RECORD], _recorded, 10),
    "coverage": Target("report.info", lambda: [LCOV, COBERTURA], _covered, 10),
}
"""By name."""
