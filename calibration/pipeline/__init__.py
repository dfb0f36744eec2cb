"""``calibration.yml`` to stages, and the stages to one verdict.

- ``configuration``: what the file says;
- ``matrix``, ``cell``: the cells of systems, noise and seeds, calibrated in parallel;
- ``judgement``: rules and limits over what the cells left in files;
- ``results``, ``summary``: results.json, tables, JUnit, Markdown;
- ``stages``: one after the other.
"""
