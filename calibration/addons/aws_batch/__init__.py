"""AWS Batch: the backend ``aws-batch`` of `calibration.ci.execution.backends`.

Its interface is `backend`, opened by name; `settings` (the section of calibration.yml), `policy` and `submitting`
(leftovers of killed runs) serve commands. The other modules are private:

- before a run: `checks` of the jobs, `job_queue`, `costs`
- requests: `inputs`, `documents`; jobs of one shape share a `definition`, and a `submission` in arrays
- the run: `submitting`, `run`, `following`, `logs`, `results`; with resume also results of an `earlier` run
- in the task: `inside`, which shares only `wire` (keys, variables, folders) and `documents` with the client
- access to AWS: `session`, `store`, `workers`
"""
