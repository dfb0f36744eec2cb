"""Continuous integration: runner, repository, images, jobs and reports. It knows nothing of calibration.

It imports `calibration.base` only.

- ``workflow``: the GitHub runner: groups, annotations, outputs, progress;
- ``git``, ``github``: the repository and its commits; pull requests and the one comment on them;
- ``report``, ``pages``: results of any work and their one publisher; one page that opens offline;
- ``introspection``: rule files, and the report of rules over tables;
- ``docker``, ``registries``, ``image``: the Docker Engine, registries, and an image from its specification;
- ``execution``: tasks, the one loop that runs them, and the backends that run jobs of containers.
"""
