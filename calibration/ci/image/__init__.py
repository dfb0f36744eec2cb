"""Container images: from a specification to a Dockerfile, an image and a registry. Independent of calibration.

- ``specification``: content of an image, as the user declares it;
- ``dockerfile``, ``repositories``: conversion to a Dockerfile;
- ``context``, ``plan``: input of the build, and its hash;
- ``building``: search by the hash, build, and push;
- ``build_request``, ``builders``: BuildKit, and the engine's classic builder. Login, push and
  promotion are in `ci.registries`.
"""
