"""Conventions that a recording may have been made by, tried where nothing fits: units, orders, directions, times.

`trying.conventions` tries what `trying.HYPOTHESES_BY_PRIORITY` lists, and names the one by which the labels fit.
"""
