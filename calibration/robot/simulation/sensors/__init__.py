"""Simulated sensors: one class for each modality, with all of its simulation."""

from calibration.robot.simulation.sensors.camera import SimulatedCamera
from calibration.robot.simulation.sensors.depth_camera import SimulatedDepthCamera
from calibration.robot.simulation.sensors.lidars import SimulatedLidar, SimulatedLidar2d
from calibration.robot.simulation.sensors.sensor import SimulatedSensor

__all__ = [
    "SIMULATED_SENSORS",
    "SimulatedCamera",
    "SimulatedDepthCamera",
    "SimulatedLidar",
    "SimulatedLidar2d",
    "SimulatedSensor",
]

SIMULATED_SENSORS: dict[str, type[SimulatedSensor]] = {
    kind.modality.name: kind for kind in (SimulatedCamera, SimulatedLidar, SimulatedLidar2d, SimulatedDepthCamera)
}
"""Simulated sensors by the name of their modality, in the order of labels in datasets."""
