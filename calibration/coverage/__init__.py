"""Coverage of a team's tests: measured or read, held against the repository, sent to a service.

Knows nothing of calibration.

- ``upload``: the process of the command;
- ``lines``: what is covered;
- ``command``, ``tests``: what is run, and what came of it; ``injection``: how the team's own Python is measured;
- ``data_file``, ``formats``, ``junit``: what coverage.py, other tools (Cobertura, LCOV) and pytest write;
- ``repository``, ``sources``, ``reading``, ``changes``: what is covered of the repository, and of a change;
- ``commit``, ``codacy``: the commit that it is for, and who is told;
- ``results``, ``report``, ``badge``: the verdict, and how it is shown.
"""
