"""GitLab CI as a CI service, and the one note on a merge request."""
