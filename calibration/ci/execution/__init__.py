"""Execution of tasks, independent of calibration.

- ``tasks``: tasks, and the loop that runs them; ``workspace``: results that survive an interruption;
- ``backends``: registry of backends: ``embedded`` (functions in the ``processes`` of this machine), ``docker`` and
  those of add-ons (jobs of containers); ``run_names``: unique names;
- ``job``, ``outcome``: a job of containers, and its result; ``placeholders``, ``ros``, ``sizes``, ``job_check``:
  parsing and validation of a job's description;
- ``supervision``, ``job_verdict``: a job's containers from the first start to the verdict; ``copying_out``,
  ``extraction``, ``globs``: copying their artifacts; ``log_file``, ``redaction``: their logs; ``job_folder``: the
  folder with both;
- ``admission``: starting jobs within the resources of the machine.
"""
