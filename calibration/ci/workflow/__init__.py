"""The runner of a step and its CI service: groups, annotations, masks, outputs, summary, progress.

`runner.py` has the interface of a service, and the plain terminal; `calibration.ci.services` names the others.
"""

from calibration.ci.workflow.runner import (
    Annotation,
    Level,
    Runner,
    add_mask,
    add_summary,
    annotate,
    group,
    report_error,
    set_outputs,
    stop_commands,
)
