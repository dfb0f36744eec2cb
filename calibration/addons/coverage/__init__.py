"""Coverage of a team's tests: measured or read from reports, compared with limits, uploaded to a service.

Independent of calibration.

- ``coverage_upload``: the command;
- ``tests``: the test command and its outcome; ``coverage_py``: coverage.py in the team's own Python, and its data;
- ``formats``: covered lines, branches and functions of a file, and reports of them (Cobertura, LCOV, gcov);
- ``sources``, ``reading``: the commit, the files and functions that coverage is of, and their coverage;
- ``codacy``: the service that receives it;
- ``pseudo_tested``, ``workers``: functions that tests run and do not test;
- ``results``, ``report``: the verdict and its presentation.
"""

from calibration.base.addons import Addon, LazyCommand, SchemaFile

ADDON = Addon(
    commands={
        "coverage-upload": LazyCommand(
            f"{__name__}.coverage_upload:command", "Run tests, check their coverage, and upload it."
        )
    },
    schemas={"coverage": SchemaFile(__name__, "results.schema.json", "results:CoverageResults", "coverage-upload")},
)
