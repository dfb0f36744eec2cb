"""Collection of datasets: one, or many scenarios; each is calibrated as a proof, and judged.

- ``request``: description of a collection;
- ``collecting``: the entry point, and the stage; it calls ``by_simulation`` or ``by_applications``;
- ``scenarios``: many datasets as jobs in containers;
- ``results``: checks and verdict; ``report``, ``scenario_report``: tables and outputs, of one dataset and of many.
"""
