"""AWS Batch: the backend that `calibration.execution.backends` registers as ``aws-batch``.

Its door is `backend`, which is opened by name; `settings` (the section of calibration.yml), `policy` and `submitting`
(what killed runs have left) serve the commands for them. Nobody else needs to know what is in here:

- before a run: `checks` of the jobs, `job_queue`, `costs`
- what is sent: `inputs`, `documents`; jobs of one shape share a `definition`, and a `submission` in arrays
- the run: `submitting`, `run`, `following`, `logs`, `results`; with resume also what is left of an `earlier` one
- in the task: `inside`, which knows the client by `wire` (keys, variables, folders) and `documents` alone
- the way into AWS: `session`, `store`, `workers`
"""
