"""Mark of the tests that are not run on every push."""

import pytest
from _pytest.mark import ParameterSet


def thorough(*values: object) -> ParameterSet:
    """Return a parameter set that is one of many of its kind: run by `make test` and every night, not by .ci/run."""
    return pytest.param(*values, marks=pytest.mark.thorough)
