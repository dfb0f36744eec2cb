"""What can be wrong, planted in a scene: functions of a scene, a size and random numbers, by what they spoil."""
