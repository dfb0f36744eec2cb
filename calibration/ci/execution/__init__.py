"""Execution of tasks, independent of calibration.

- ``tasks``: tasks, the loop that runs them, and results that survive an interruption;
- ``backends``: registry of backends: ``embedded`` (functions in processes of this machine), ``docker`` and those of
  add-ons (jobs of containers);
- ``job``, ``outcome``: a job of containers, and its result; ``sizes``, ``job_check``: parsing and validation of a job's
  description; ``ros``: what ROS needs beside its containers;
- ``supervision``: a job's containers from the first start to the verdict; ``artifacts``, ``extraction``: copying their
  artifacts; their logs are in `ci.workflow.streams`.
"""
