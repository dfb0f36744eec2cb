"""Rendering of sensor data: camera images, depth images, LiDAR scans."""
