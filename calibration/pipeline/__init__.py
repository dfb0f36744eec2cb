"""The pipeline of ``calibration.yml``: its stages, and one verdict.

- ``configuration``, ``system``: the file and its systems; ``first_configuration``: a first one, for ``init``;
- ``matrix``: systems, noise and seeds as cells, calibrated by our engine or by the team's software, and judged;
- ``collection``: simulated datasets, collected by our simulation or by the team's software, and judged;
- ``convergence``: the matrix swept over the noise of the initial guess;
- ``repetition``: a run, or a collection, several times: times, spreads, the first stage that differs, flakes;
- ``results``: what a run has found; ``report``: its report, of ``report_blocks``; ``page``: the page;
- ``baselines``: the accepted calibration that results are compared with, and its update;
- ``stages``: the stages in order; ``distribution``: spread over the jobs of a workflow, and gathered again.
"""
