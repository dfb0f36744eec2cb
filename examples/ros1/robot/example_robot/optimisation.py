"""The calibration: least squares over the poses of the cameras and of the board in every collection."""

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from example_robot.poses import along, from_entry, from_vector, pose, to_entry, to_vector


class Observations:
    """What all cameras saw of the board, and the frames between."""

    def __init__(self, document, board, cameras):
        self.world, self.sensors = document["calibration_config"]["world_link"], document["sensors"]
        self.names = sorted(cameras)
        (pattern,) = document["calibration_config"]["calibration_patterns"]
        self.keys = sorted(document["collections"], key=int)
        self.views = []
        """(camera, number of the collection, T_world_parent, T_child_camera, points, pixels)."""
        for number, key in enumerate(self.keys):
            collection = document["collections"][key]
            for name in self.names:
                label = collection["labels"][pattern].get(name, {"detected": False})
                if label["detected"]:
                    sensor, transforms = self.sensors[name], collection["transforms"]
                    before = along(transforms, self.world, sensor["calibration_parent"])
                    after = along(transforms, sensor["calibration_child"], sensor["parent"])
                    points = board.corners[[corner["id"] for corner in label["idxs"]]]
                    pixels = np.array([(corner["x"], corner["y"]) for corner in label["idxs"]])
                    self.views.append((name, number, before, after, points, pixels))
        self.cameras = cameras

    def boards_from(self, guesses):
        """``T_world_board`` of every collection by the first camera that sees it, where that is thought to be."""
        boards = {}
        for name, number, before, after, points, pixels in self.views:
            if number not in boards:
                T_camera_board = self.cameras[name].board_pose(points, pixels)
                boards[number] = before @ guesses[name] @ after @ T_camera_board
        return boards

    def residuals(self, guesses, boards):
        """Projected minus seen corners of all views, px."""
        errors = []
        for name, number, before, after, points, pixels in self.views:
            T_world_camera = before @ guesses[name] @ after
            T_camera_board = np.linalg.inv(T_world_camera) @ boards[number]
            errors.append((self.cameras[name].project(T_camera_board, points) - pixels).ravel())
        return np.concatenate(errors)


def calibrate(observations, guesses):
    """The poses of the cameras by name, and the RMS of the reprojected corners (px).

    The board's poses are unknown, so nothing ties the cameras to the world: the first one stays where it is.
    """
    boards = observations.boards_from(guesses)
    seen, moving = sorted(boards), observations.names[1:]
    start = np.concatenate([to_vector(guesses[name]) for name in moving] + [to_vector(boards[i]) for i in seen])

    def poses(parameters):
        found = [from_vector(vector) for vector in parameters.reshape(-1, 6)]
        cameras = {observations.names[0]: guesses[observations.names[0]], **dict(zip(moving, found, strict=False))}
        return cameras, dict(zip(seen, found[len(moving) :], strict=True))

    result = least_squares(lambda x: observations.residuals(*poses(x)), start, x_scale="jac", ftol=1e-6, xtol=1e-9)
    if not result.success or not np.isfinite(result.x).all():
        raise ValueError(f"the optimisation did not converge: {result.message}")
    return poses(result.x)[0], float(np.sqrt((result.fun.reshape(-1, 2) ** 2).sum(-1).mean()))


def starting_guesses(document):
    """The calibrated transform of every camera, as the dataset's first collection has it."""
    first = document["collections"][min(document["collections"], key=int)]["transforms"]
    return {name: from_entry(first[edge_key(sensor)]) for name, sensor in document["sensors"].items()}


def with_noise(guesses, translation, rotation, seed):
    """Guesses that are off by a length (m) in any direction and an angle (rad) about each axis."""
    random = np.random.default_rng(seed)
    noisy = {}
    for name, T in guesses.items():
        direction = random.normal(size=3)
        angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz") + rotation * random.choice([-1, 1], 3)
        offset = translation * direction / np.linalg.norm(direction)
        noisy[name] = pose(Rotation.from_euler("xyz", angles), T[:3, 3] + offset)
    return noisy


def with_poses(document, cameras):
    """The dataset with the cameras' poses in every collection."""
    collections = {}
    for key, collection in document["collections"].items():
        changed = {
            edge_key(document["sensors"][name]): to_entry(
                document["sensors"][name]["calibration_parent"], document["sensors"][name]["calibration_child"], T
            )
            for name, T in cameras.items()
        }
        collections[key] = {**collection, "transforms": {**collection["transforms"], **changed}}
    return {**document, "collections": collections}


def edge_key(sensor):
    """The key of a sensor's calibrated transform."""
    return f"{sensor['calibration_parent']}-{sensor['calibration_child']}"
