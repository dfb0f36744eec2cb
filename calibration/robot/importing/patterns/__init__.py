"""Patterns in the images of a recording.

- ``image_views``: their detection; ``near_miss``: patterns that images show undescribed, causes of missing detections;
- ``contact_sheet``: a picture of the detections.
"""
