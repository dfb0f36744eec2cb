"""Container registries: image names, credentials, push, and promotion."""
