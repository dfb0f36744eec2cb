"""The programs that turn a Dockerfile and its context into an image."""
