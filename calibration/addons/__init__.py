"""Add-ons: features with few ties to the rest, each in a folder of its own.

An add-on may import every other floor, and no other add-on; no other floor imports an add-on. Its ``__init__`` declares
what it brings (`calibration.base.addons`), so that its folder can be deleted and the rest works without it.

- ``analysis``: analysers run on a repository, their findings compared with the base;
- ``aws_batch``: jobs of containers on AWS Batch, images in ECR;
- ``coverage``: tests measured, reports read, compared with limits, sent to a service;
- ``delivery``: a bundle of accepted calibrations, signed, and a check of it on the robot;
- ``guard``: whether a sensor has moved since it was accepted, by an ordinary recording;
- ``recorder``: the page on which a motion is recorded;
- ``requirements``: requirements over messages, judged over a bag;
- ``rigel``: Rigelfiles, read to be converted.
"""
