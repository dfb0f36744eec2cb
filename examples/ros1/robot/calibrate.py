#!/usr/bin/env python3
"""The team's calibration: the poses of the cameras, from a dataset and the starting guess that is in it.

Writes ``rgb_to_rgb_results.csv`` and the calibrated ``dataset.json`` into the output folder. Needs no ROS.
"""

import argparse
import json
import sys
from pathlib import Path

from example_robot import table
from example_robot.board import Board
from example_robot.camera import Camera
from example_robot.optimisation import Observations, calibrate, starting_guesses, with_noise, with_poses


def main():
    """Calibrate; 1 where it fails."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--dataset", type=Path, required=True, help="folder with dataset.json")
    options.add_argument("--output", type=Path, required=True, help="folder for the results")
    options.add_argument("--translation-noise", type=float, default=0.0, help="of the starting guess, m")
    options.add_argument("--rotation-noise", type=float, default=0.0, help="of the starting guess, rad")
    options.add_argument("--seed", type=int, default=1, help="of the noise")
    options.add_argument("--source", default="right_camera", help="camera whose corners are carried over")
    options.add_argument("--target", default="left_camera", help="camera that they are compared with")
    arguments = options.parse_args()
    try:
        run(arguments)
    except (OSError, ValueError, KeyError) as error:
        print(f"calibrate: {type(error).__name__}: {error}", file=sys.stderr)
        return 1
    return 0


def run(arguments):
    """Read, calibrate, evaluate, write."""
    document = json.loads((arguments.dataset / "dataset.json").read_text(encoding="utf-8"))
    (pattern,) = document["calibration_config"]["calibration_patterns"].values()
    board = Board(pattern)
    cameras = {name: Camera(sensor["camera_info"]) for name, sensor in document["sensors"].items()}
    guesses = starting_guesses(document)
    if arguments.translation_noise or arguments.rotation_noise:
        guesses = with_noise(guesses, arguments.translation_noise, arguments.rotation_noise, arguments.seed)
    poses, rms = calibrate(Observations(document, board, cameras), guesses)
    calibrated = with_poses(document, poses)
    found = table.rows(calibrated, board, cameras, arguments.source, arguments.target)
    arguments.output.mkdir(parents=True, exist_ok=True)
    table.write(arguments.output / "rgb_to_rgb_results.csv", found)
    text = json.dumps(calibrated, indent=2, sort_keys=True)
    (arguments.output / "dataset.json").write_text(text, encoding="utf-8")
    print(f"calibrated {len(cameras)} cameras from {len(document['collections'])} collections: RMS {rms:.4f} px")


if __name__ == "__main__":
    sys.exit(main())
