"""ATOM's table of how well two cameras agree: a row for each collection that both saw, and their averages."""

import csv

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from example_robot.poses import along

COLUMNS = ("RMS (pix)", "X err (pix)", "Y err (pix)", "Trans (mm)", "Rot (deg)")


def rows(document, board, cameras, source, target):
    """The numbers of every collection that both cameras saw, by its key."""
    (pattern,) = document["calibration_config"]["calibration_patterns"]
    frames = document["sensors"][target]["parent"], document["sensors"][source]["parent"]
    world = document["calibration_config"]["world_link"]
    found = {}
    for key in sorted(document["collections"], key=int):
        collection = document["collections"][key]
        labels = collection["labels"][pattern]
        if all(labels.get(name, {}).get("detected") for name in (source, target)):
            T_world_target, T_world_source = (along(collection["transforms"], world, frame) for frame in frames)
            T_target_source = np.linalg.inv(T_world_target) @ T_world_source
            found[key] = _row(board, cameras[source], cameras[target], labels[source], labels[target], T_target_source)
    if not found:
        raise ValueError(f"{source} and {target} saw the board together in no collection")
    return found


def _row(board, source, target, source_label, target_label, T_target_source):
    of_source, of_target = (
        {corner["id"]: (corner["x"], corner["y"]) for corner in label["idxs"]} for label in (source_label, target_label)
    )
    places = board.corners - board.corners[0]  # millimetres are those of the first corner, as in ATOM
    T_source_board, T_target_board = (
        camera.board_pose(places[list(corners)], np.array(list(corners.values())))
        for camera, corners in ((source, of_source), (target, of_target))
    )
    common = sorted(of_source.keys() & of_target.keys())
    if not common:
        raise ValueError("the cameras saw no corner in common")
    # the rays of the source's corners meet the board's plane; there the target should see them
    pixels = np.array([of_source[i] for i in common])[:, None]
    rays = cv2.undistortPoints(pixels, source.matrix, source.distortion)[:, 0]
    rays = np.column_stack([rays, np.ones(len(rays))])
    normal = T_source_board[:3, 2]
    points = rays * ((normal @ T_source_board[:3, 3]) / (rays @ normal))[:, None]
    error = target.project(T_target_source, points) - np.array([of_target[i] for i in common])
    apart = np.linalg.inv(T_target_source @ T_source_board) @ T_target_board
    return (
        np.sqrt((error**2).sum(-1).mean()),
        *np.abs(error).mean(0),
        1000 * np.linalg.norm(apart[:3, 3]),
        np.degrees(Rotation.from_matrix(apart[:3, :3]).magnitude()),
    )


def write(path, found):
    """Write the rows, and the averages of what is printed in them."""
    printed = {key: [f"{value:.4f}" for value in row] for key, row in found.items()}
    means = np.array(list(printed.values()), float).mean(0)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["Collection #", *COLUMNS])
        writer.writerows([key, *row] for key, row in printed.items())
        writer.writerow(["Averages", *(f"{value:.4f}" for value in means)])
