"""A recipe of packages, files and a workspace as a Dockerfile and a start script."""
