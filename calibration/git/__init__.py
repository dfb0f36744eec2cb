"""The git repository that a run is about, and the commits that it compares."""
