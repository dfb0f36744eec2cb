"""The pipeline of ``calibration.yml``: its stages, and one verdict.

- ``configuration``: reads the file;
- ``matrix``: systems, noise and seeds as cells, calibrated by our engine or by the team's software, and judged;
- ``collection``: simulated datasets, collected by our simulation or by the team's software, and judged;
- ``convergence``: the matrix swept over the noise of the initial guess;
- ``results``, ``report``: the results and their report;
- ``stages``: the stages in order; ``distribution``: spread over the jobs of a workflow, and gathered again.
"""
