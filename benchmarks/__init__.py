"""Measurements of the speed and accuracy that the suite claims: ``make bench``, ``python -m benchmarks``.

Times are compared with what the same machine does at the same moment, so that the bars hold on any
machine: with one straightforward numpy pass over the data (`benchmarks.floor`), or with other solvers.
"""

import os

AS_FOUND = dict(os.environ)
"""The environment before this package changed it."""

# One thread for linear algebra, for all solvers alike; it has to be said before numpy is imported.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
