"""Pages that open offline.

- ``run_page``: ``report.html`` of a run;
- ``in_space``, ``label_residuals``: its parts on one system.
"""
