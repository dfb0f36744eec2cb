"""Expansion of a xacro to URDF, in a process that can do nothing else."""
