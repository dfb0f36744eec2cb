"""Defects to plant in a scene: functions of a scene, a size and random numbers, by what they spoil."""
