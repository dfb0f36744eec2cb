"""An accepted calibration, kept in git, and what has changed since.

A `snapshot.Snapshot` is a calibration's result in numbers that can be compared; `document` is the reviewed file of
accepted ones, ``calibration-baseline.json``; `comparison` says how far two lie apart, `verdict` what that means.
"""
