"""Datasets collected in simulation, proven by calibrating them, and judged."""
