"""AWS Batch: the backend ``aws-batch`` of `calibration.ci.execution.backends`.

Its interface is `ADDON`: `backend` (and leftovers of killed runs), opened by name, `settings` (the section of
calibration.yml), `ecr` and the command `aws_policy`. The other modules are private:

- before a run: `checks` of jobs, images and queue
- requests: jobs of one shape share a `definition`
- the run: `submitting` in arrays, `run`, `following`, `logs`, `results`; with resume also results of an earlier run
- in the task: `inside`, which shares only `wire` (keys, variables, folders, documents) with the client
- access to AWS: `session`, `store` (with the inputs of jobs)
"""

from calibration.base.addons import Addon, BackendKind, DocumentSection, LazyCommand, SchemaFile

ADDON = Addon(
    commands={
        "aws-policy": LazyCommand(
            f"{__name__}.aws_policy:command", "Print the IAM policies that jobs on AWS Batch need."
        )
    },
    sections={
        "aws-batch": DocumentSection(
            f"{__name__}.settings:BatchSettings", "Settings of AWS Batch, for containers that run there."
        )
    },
    backends={
        "aws-batch": BackendKind(f"{__name__}.backend:open_batch", f"{__name__}.backend:open_leftovers", resumes=True)
    },
    registry_logins={"ecr": f"{__name__}.ecr:ecr_credentials"},
    schemas={"aws-batch": SchemaFile(__name__, "batch.schema.json", "settings:BatchFile")},
)
