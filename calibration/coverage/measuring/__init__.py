"""Tests run as their team runs them, and measured by coverage.py in every Python process that they start.

``injected`` is what runs in the team's own Python, which may be older than ours; it is never imported here.
"""
