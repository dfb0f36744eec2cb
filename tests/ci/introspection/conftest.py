"""Tables as ATOM writes them, as for the tests of rules."""

from tests.base.tables.conftest import atom

__all__ = ["atom"]
