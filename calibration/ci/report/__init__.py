"""Results of a command for people and programs, independent of calibration.

A command describes its results in a :class:`Report`: its verdict, a :class:`Check` for each limit, an
:class:`Outcome` for each unit of work, tables and notes. :func:`publish` writes and shows all of it.
"""

from calibration.base import count_of
from calibration.base.verdict import VERDICTS, Check, Verdict, at_least, at_most, expectation, verdict_of, worst_verdict
from calibration.ci.report.blocks import RESULTS_FILE, Block, Code, Lines, Table, Text, shown
from calibration.ci.report.junit import Outcome, outcome_of_check
from calibration.ci.report.report import (
    FILES,
    Head,
    Report,
    publish,
    read_results_file,
    reasons_in,
    remove_results,
    results_text,
    show,
)
