"""Datasets collected in simulation: robots, sensors, the scene around them, motion, labels.

`calibration.simulation.system.read_system` reads a system from its folder,
`calibration.simulation.collection.capture.collect` plays a motion and labels what the sensors see, and
`calibration.simulation.collection.dataset_folder.write_dataset_folder` makes an ATOM dataset of it.
"""
