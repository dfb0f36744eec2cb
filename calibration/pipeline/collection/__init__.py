"""Datasets collected in simulation, proven by calibrating them, and judged.

- ``request``: what is to be collected, by our own simulation or by the team's ``applications``;
- ``collecting``: one dataset; by applications: ``application_dataset``;
- ``worlds``: many datasets: ``own_worlds`` or ``application_worlds``, as functions here or as jobs in containers;
- ``world_folder``, ``world_file``: what worlds in containers leave, and what is kept of it;
- the rest: results and reports.
"""
