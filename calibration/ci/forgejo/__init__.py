"""Forgejo and Gitea Actions as a CI service, and the one comment on a pull request."""
