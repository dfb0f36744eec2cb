"""Interface to the GitHub runner, independent of calibration.

Everything here works outside of GitHub too: annotations become plain lines, outputs and summaries are
not written if the runner provides no file for them.
"""

from calibration.ci.workflow.annotations import Annotation, Level, annotate, report_error
from calibration.ci.workflow.groups import group, stop_commands
from calibration.ci.workflow.masks import add_mask
from calibration.ci.workflow.outputs import set_outputs
from calibration.ci.workflow.runner import Runner
from calibration.ci.workflow.summary import add_summary

__all__ = [
    "Annotation",
    "Level",
    "Runner",
    "add_mask",
    "add_summary",
    "annotate",
    "group",
    "report_error",
    "set_outputs",
    "stop_commands",
]
