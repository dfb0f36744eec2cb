"""A camera's intrinsics, from a CameraInfo as the dataset has it."""

import os

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from example_robot.poses import pose


class Camera:
    """Projects points, and finds a board's pose from its corners."""

    def __init__(self, info):
        self.matrix = np.reshape(info["K"], (3, 3)).astype(float)
        self.distortion = np.array(info["D"], float)
        if os.environ.get("ROBOT_BUG") == "1":  # a mistake to try the pipeline with: cx and cy are swapped
            self.matrix[[0, 1], 2] = self.matrix[[1, 0], 2]

    def project(self, T_camera_points, points):
        """The pixels (K, 2) of points (K, 3)."""
        rotation = Rotation.from_matrix(T_camera_points[:3, :3]).as_rotvec()
        pixels, _ = cv2.projectPoints(points, rotation, T_camera_points[:3, 3], self.matrix, self.distortion)
        return pixels.reshape(-1, 2)

    def board_pose(self, points, pixels):
        """``T_camera_board`` from the board's points (K, 3) and their pixels (K, 2)."""
        _, rotation, translation = cv2.solvePnP(points, pixels, self.matrix, self.distortion)
        return pose(Rotation.from_rotvec(rotation.ravel()), translation)
