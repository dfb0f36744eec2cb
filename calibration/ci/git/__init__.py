"""The git repository of a run, and the commits that are compared."""
