"""Where work runs. Knows nothing of calibration.

- ``tasks``: a task, and the one loop that runs tasks; ``workspace``: what of them is done, when they are interrupted;
- ``backends``: what runs work, by name: ``embedded`` (functions in processes), ``docker`` and ``batch`` (jobs of
  containers);
- ``job``, ``outcome``: a job of containers, and what came of it; ``document``, ``placeholders``, ``ros``,
  ``job_check``: from a description to a job that makes sense;
- ``supervision``, ``judging``: the containers of a job from the first start to the verdict; ``bringing_out``,
  ``extraction``, ``globs``: the files that they leave; ``log_file``, ``redaction``: what they print;
- ``admission``: which job may start when.
"""
