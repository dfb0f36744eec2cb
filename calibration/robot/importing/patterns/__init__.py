"""Patterns in the images and range data of a recording.

- ``image_views``, ``range_data``: their detection; ``shown_patterns``, ``near_miss``: patterns that
  images show undescribed, causes of missing detections;
- ``starting_intrinsics``: initial guess of unknown intrinsics; ``contact_sheet``, ``png``: a picture of the detections.
"""
