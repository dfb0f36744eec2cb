"""What sensors see of the simulated world: camera images, depth images, LiDAR scans."""
