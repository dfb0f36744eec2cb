"""Names of the export formats; their functions, which only an export needs, are in `exports.formats`."""

URDF = "urdf"
"""The only format that needs an input file: the robot's URDF."""
FORMATS = ("xacro", "ros1", "ros2", "ros2-xml", "tf-static", "autoware", "camera-info", "kalibr", "opencv")
"""The others, in the order of their files."""
OF_CAMERAS = ("camera-info", "kalibr", "opencv")
"""Those of cameras, which need no calibrated transform."""
