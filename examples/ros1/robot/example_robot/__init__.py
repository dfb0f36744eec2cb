"""The team's own software: collects a dataset and calibrates two cameras. Knows nothing of Calibration CI."""
