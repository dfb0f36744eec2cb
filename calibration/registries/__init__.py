"""Registries: what images are called there, who may see them, push, and promotion."""
