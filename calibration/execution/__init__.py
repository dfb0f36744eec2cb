"""Where work runs. Knows nothing of calibration."""
