"""The pipeline of ``calibration.yml``: its stages, and one verdict.

- ``configuration``, ``system``: the file and its systems; ``first_configuration``: a first one, for ``init``;
- ``matrix``: systems, noise and seeds as cells, calibrated by our engine or by the team's software, and judged;
- ``collection``: simulated datasets, collected by our simulation or by the team's software, and judged;
- ``containers``: programs of the team, in containers, in place of our engine and our simulation;
- ``convergence``: the matrix swept over the noise of the initial guess;
- ``repetition``: a run, or a collection, several times: times, spreads, the first stage that differs, flakes;
- ``results``: what a run has found; ``report``, ``report_tables``: its report; ``page``: the page;
- ``baselines``: the accepted calibration that results are compared with, and its update;
- ``next_poses``: what to record next; ``watching``: a recording while it is made; ``history``: accepted calibrations;
- ``running``: the stages in order; ``stages``: what each does;
- ``workflow_plan``, ``gathering``: a run spread over the jobs of a workflow, and gathered again.
"""
