"""``calibration.yml`` to stages, and the stages to one verdict.

- ``configuration``: what the file says;
- ``matrix``: systems, noise and seeds as cells, calibrated by our engine or by the team's software, and judged;
- ``collection``: datasets collected in simulation, by us or by the team's software, and judged;
- ``convergence``: the matrix swept over the noise of the start;
- ``results``, ``report``: what they found, and how it is told;
- ``stages``: one after the other; ``distribution``: spread over the jobs of a workflow, and gathered again.
"""
