"""Conversion of a recipe (packages, files, workspace) to a Dockerfile and a start script."""
