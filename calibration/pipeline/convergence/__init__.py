"""Convergence region: the matrix swept over the noise of the initial guess, as maps of the share that converges."""
