"""GitHub's API: pull requests, and one comment on them that is kept up to date. Independent of calibration."""
