"""Simulated datasets: robots, sensors, the scene around them, motion, labels.

`calibration.robot.simulation.system.read_system` reads a system from its folder,
`calibration.robot.simulation.record.collect` plays a motion and labels the sensors' data, and
`calibration.robot.simulation.dataset_folder.write_dataset` writes them as an ATOM dataset.
"""
