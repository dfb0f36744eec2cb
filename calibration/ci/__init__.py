"""Continuous integration: runner, repository, images, jobs and reports. It knows nothing of calibration.

It imports `calibration.base` only.

- ``workflow``: what a step tells its CI service or a terminal: groups, annotations, outputs, progress;
- ``git``: the repository, its commits and changes;
- ``github``, ``gitlab``, ``forgejo``: CI services, and the one comment on a pull request; ``services.py`` names them;
- ``report``, ``pages``: results of any work and their one publisher; one page that opens offline;
- ``introspection``: rule files, and the report of rules over tables;
- ``docker_engine``, ``registries``, ``image``: the Docker Engine, registries, and an image from its specification;
- ``execution``: tasks, the one loop that runs them, and the backends that run jobs of containers.
"""
