"""Coverage of a team's tests: measured or read, held against the repository, sent to a service.

Knows nothing of calibration.

- ``lines``, ``rate``: what is covered;
- ``measuring``: tests run and measured in the team's own Python;
- ``reports``: reports of others (coverage.py, Cobertura, LCOV);
- ``repository``, ``paths``, ``changes``: the git repository, and what is covered of it and of a change;
- ``commit``, ``services``: the commit that it is for, and who is told;
- ``results``, ``badge``, ``presentation``: the verdict, and how it is shown.
"""
