"""``calibration.yml`` to stages, and the stages to one verdict.

- ``configuration``: what the file says;
- ``matrix``: systems, noise and seeds as cells, calibrated by our engine or by the team's software, and judged;
- ``collection``: datasets collected in simulation, by us or by the team's software, and judged;
- ``results``, ``summary``, ``report``: results.json, tables, JUnit, Markdown;
- ``stages``: one after the other.
"""
