"""Scenario sets: variations of a system, each addressed by its id, and the parameters that drive the error."""
