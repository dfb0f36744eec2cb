"""Pages that open offline.

- ``run_page``: ``report.html`` of a run; ``in_space``, ``label_residuals``, ``worst_views``, ``projection``: its parts
  on one system;
- ``collection_page``: the page of a simulated dataset.
"""
