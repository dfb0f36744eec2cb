"""Coverage of a team's tests: measured or read from reports, compared with limits, uploaded to a service.

Independent of calibration.

- ``coverage_upload``: the command;
- ``lines``: covered lines and branches of a file;
- ``command``, ``tests``: the test command and its outcome; ``injection``: coverage.py in the team's own Python;
- ``data_file``, ``formats``: the formats of coverage.py and other tools (Cobertura, LCOV);
- ``sources``, ``reading``: coverage of the repository's files;
- ``commit``, ``codacy``: the commit that the coverage belongs to, its changed lines, and the service that receives it;
- ``functions``, ``pseudo_tested``, ``test_worker``: functions that tests run and do not test;
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
