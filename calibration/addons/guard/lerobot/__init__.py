"""Recordings of robot learning: whether a camera has moved between or within the episodes of a dataset.

- ``episodes``: the episodes of a LeRobot dataset (v2, v3) or of folders as DROID's, and where their data are;
- ``frames``: some frames of a video, sought by their times;
- ``dataset_calibration``: the file ``meta/calibration.json``, read and written;
- ``dataset_check``: one answer a camera and episode, and the table for the dataset's card.
"""
