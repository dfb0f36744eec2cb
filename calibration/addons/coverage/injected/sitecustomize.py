"""Starts the measurement, or the replacement of functions, in every Python process of the tests.

They find it by PYTHONPATH when they start.

coverage.py has a start of its own (a .pth file, and its setting ``patch = subprocess``), by which it starts here too
where the tests' Python has a version that brings the file. It cannot take the place of this: a Python without
coverage.py, which is given ours, and one with a version before 7.10 (for Python 3.8 there is no newer one) start
nothing by themselves; and the setting hands on a measurement that has begun: in ``make test`` none has.

It leaves a note of what came of it, and then gives way to the sitecustomize that would have run without it.
Whatever goes wrong here must not change what the tests do.
"""

# mypy: ignore-errors
# ruff: noqa: PTH100, PTH110, PTH118, PTH120, PTH123, UP031

import json
import os
import sys
import zlib

_HERE = os.path.dirname(os.path.abspath(__file__))


def _start():
    note = {"python": sys.version.split()[0], "executable": sys.executable}
    try:
        from calibration_coverage import import_coverage

        coverage = import_coverage()
        note["coverage"] = coverage.__version__
        coverage.process_startup()
    except Exception as error:
        note["problem"] = "%s: %s" % (type(error).__name__, error)
    try:
        name = "%s-%08x.json" % (note["python"], zlib.crc32(sys.executable.encode("utf-8", "replace")) & 0xFFFFFFFF)
        path = os.path.join(os.environ["CALIBRATION_COVERAGE_NOTES"], name)
        if not os.path.exists(path):  # one is enough for all processes of one Python
            with open(path, "w") as file:
                json.dump(note, file)
    except Exception:
        return


def _give_way():
    """Run the sitecustomize of this Python or of the team, if there is one."""
    before = sys.modules.pop("sitecustomize", None)
    path = list(sys.path)
    sys.path[:] = [entry for entry in path if os.path.abspath(entry) != _HERE]
    try:
        __import__("sitecustomize")
    except ImportError as error:
        sys.modules["sitecustomize"] = before
        if getattr(error, "name", "sitecustomize") != "sitecustomize":
            raise
    finally:
        sys.modules.setdefault("sitecustomize", before)


if "CALIBRATION_COVERAGE_NOTES" in os.environ:
    _start()
    _give_way()
elif "CALIBRATION_PSEUDO_PLAN" in os.environ and sys.version_info >= (3, 8):  # ast tells columns since then
    import calibration_pseudo_tested

    calibration_pseudo_tested.start()
    _give_way()
    sys.path.append(_HERE)  # where pytest finds the plugin
else:
    _give_way()
