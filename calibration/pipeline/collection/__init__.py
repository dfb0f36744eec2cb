"""Collection of datasets: one, or many scenarios; each is calibrated for the proof, and judged.

- ``request``: what to collect; ``applications``: the containers of a team that collects by its own;
- ``collecting``: the entry; it calls ``by_simulation`` or ``by_applications``;
- ``scenarios``: many datasets as jobs in containers; ``scenario_file``: what each leaves beside its dataset;
- ``results``: checks and verdict; ``report``, ``scenario_report``: tables and outputs, of one dataset and of many.
"""
