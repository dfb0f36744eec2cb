"""A pipeline spread over the jobs of a workflow, and gathered again.

- ``slug``: names that every system of files and artifacts takes;
- ``plan``: which jobs run, and what each calibrates;
- ``plan_outputs``: the plan as outputs of a job, and back;
- ``clock``: how long a job took, as it says itself;
- ``needs``: what became of the jobs;
- ``cost``: what the jobs took, in billed minutes and money;
- ``gathering``: what the jobs left, as one set of results with one verdict.
"""
