"""Systems, noise and seeds: every combination is a cell, and has a verdict."""
