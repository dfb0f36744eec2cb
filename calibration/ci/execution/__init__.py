"""Execution of tasks, independent of calibration.

- ``tasks``: tasks, the loop that runs them, functions in processes of this machine, and results that survive an
  interruption;
- ``backends``: registry of backends for jobs of containers: ``docker``, and those of add-ons;
- ``job``, ``outcome``: a job of containers, with its sizes and times, and its result; ``job_check``: its validation;
  ``ros``: what ROS needs beside its containers;
- ``supervision``: a job's containers from the first start to the verdict; ``extraction``: tars of untrusted
  content; their logs are in `ci.workflow.streams`.
"""
