"""Matrix of systems, noise and seeds: every combination is a cell with a verdict."""
