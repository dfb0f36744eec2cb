"""Collections: a motion is played, every sensor's data labelled and checked, and a dataset written."""
