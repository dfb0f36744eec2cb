"""Add-ons: features with few ties to the rest, each in a folder of its own.

An add-on may import every other floor; no other floor imports an add-on.

- ``analysis``: analysers run on a repository, their findings compared with the base;
- ``aws_batch``: jobs of containers on AWS Batch, images in ECR;
- ``coverage``: tests measured, reports read, compared with limits, sent to a service;
- ``recorder``: the page on which a motion is recorded;
- ``rigel``: Rigelfiles, read to be converted.
"""
