"""A specification to a Dockerfile, an image, a registry. Knows nothing of calibration.

- ``specification``: what an image is made of;
- ``recipe``: that as a Dockerfile;
- ``context``, ``bases``, ``plan``, ``content_key``: what goes in, and its hash;
- ``building``: found by the hash, or built, and pushed;
- ``builders``: the engine's own, and BuildKit;
- ``registries``: references, login, push, promotion.
"""
