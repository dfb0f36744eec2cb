"""Checks of a calibration that need no ground truth: what is wrong, by how much, and what it does to the sensors."""
