"""Writes Cobertura XML of a data file of coverage.py: ``write_report.py CONFIGURATION DATA OUTPUT``.

Runs in the Python that measured, because only that one knows for sure how the team's files are to be read, and in the
folder that the names of the report are relative to.
"""

# mypy: ignore-errors

import sys

from calibration_coverage import import_coverage


def main(configuration, data, output):
    """Write the report; files that cannot be read or parsed are left out of it."""
    coverage = import_coverage()
    measured = coverage.Coverage(data_file=data, config_file=configuration)
    measured.load()
    measured.xml_report(outfile=output, ignore_errors=True)


main(*sys.argv[1:])
