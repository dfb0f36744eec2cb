"""Simulated datasets: robots, sensors, the scene around them, motion, labels.

`calibration.simulation.system.read_system` reads a system from its folder,
`calibration.simulation.collection.poses.collect` plays a motion and labels the sensors' data, and
`calibration.simulation.collection.dataset_folder.write_dataset` writes them as an ATOM dataset.
"""
