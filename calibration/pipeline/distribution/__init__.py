"""A pipeline spread over the jobs of a workflow, and gathered again.

- ``plan``: which jobs run, and what each calibrates;
- ``plan_outputs``: the plan as outputs of a job, and back;
- ``jobs``: what became of the jobs, and how long they took, as they say themselves;
- ``cost``: what the jobs took, in billed minutes and money;
- ``gathering``: what the jobs left, as one set of results with one verdict.
"""
