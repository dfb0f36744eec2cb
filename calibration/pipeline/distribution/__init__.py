"""Distribution of a pipeline over the jobs of a workflow, and collection of their results.

- ``plan``: the jobs, and the cells of each; as outputs of a job, and back;
- ``jobs``: results and durations of the jobs, as reported by themselves; billed minutes and money;
- ``gathering``: the jobs' files as one set of results with one verdict.
"""
