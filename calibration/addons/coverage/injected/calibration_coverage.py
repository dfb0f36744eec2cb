"""Finds a coverage.py: that of this Python, else the one that is brought along.

As a program it writes Cobertura XML of a data file: ``calibration_coverage.py CONFIGURATION DATA OUTPUT``, in the
folder that the names of the report are relative to. Only the Python that measured knows for sure how files are read.

Runs in the Python of the team's tests, whichever version that is (3.6 and newer; 2.7 reads it and fails politely).
"""

# mypy: ignore-errors

import os
import sys


def import_coverage():
    """Import coverage.py; its folder is on the path only meanwhile, so that the tests see no package but their own."""
    try:
        import coverage
    except ImportError:
        brought = os.environ["CALIBRATION_COVERAGE_BROUGHT"]
        sys.path.append(brought)
        try:
            import coverage
        except Exception:
            for name in [name for name in sys.modules if name.partition(".")[0] == "coverage"]:
                del sys.modules[name]
            raise
        finally:
            sys.path.remove(brought)
    return coverage


def write_report(configuration, data, output):
    """Write the report; files that cannot be read or parsed are left out of it."""
    coverage = import_coverage()
    measured = coverage.Coverage(data_file=data, config_file=configuration)
    measured.load()
    measured.xml_report(outfile=output, ignore_errors=True)


if __name__ == "__main__":
    write_report(*sys.argv[1:])
