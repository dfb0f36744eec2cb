"""Coverage of a team's tests: measured or read from reports, compared with limits, uploaded to a service.

Independent of calibration.

- ``upload``: the implementation of the command ``coverage-upload``;
- ``lines``: covered lines and branches of a file;
- ``command``, ``tests``: the test command and its outcome; ``injection``: coverage.py in the team's own Python;
- ``data_file``, ``formats``, ``junit``: the formats of coverage.py, other tools (Cobertura, LCOV) and pytest;
- ``sources``, ``reading``, ``changes``: coverage of the repository's files, and of the lines of a change;
- ``commit``, ``codacy``: the commit that the coverage belongs to, and the service that receives it;
- ``results``, ``report``, ``badge``: the verdict and its presentation.
"""
