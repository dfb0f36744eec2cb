"""Assumed standard deviations of fixed parameters: errors of a camera, a board or an arm."""

from dataclasses import fields
from typing import Annotated

from calibration.base.records import at_least, field, record

Known = Annotated[float, at_least(0)]


@record
class Assumptions:
    """Standard deviations of fixed parameters; 0 for exactly known ones, as in a simulation."""

    focal_length: Known | None = field("Of a camera, relative; else as a nominal calibration's.", default=None)
    aspect: Known | None = field("Of a camera: fx over fy, relative; likewise.", default=None)
    principal_point: Known | None = field("Of a camera, each axis; likewise.", default=None, unit="px")
    distortion: Known | None = field("Of a camera: the first coefficient of its lens, k1; likewise.", default=None)
    pattern_size: Known = field("Of the printed squares, relative.", default=0.0005)
    pattern_stretch: Known = field("Of the squares' length over their height, relative.", default=0.0002)
    flatness: Known = field("Of the board: its middle against its ends.", default=0.0002, unit="m")
    border: Known = field("Of the board's border about its squares.", default=0.0005, unit="m")
    range_bias: Known = field("Of a LiDAR or a depth camera.", default=0.001, unit="m")
    range_scale: Known = field("Of a LiDAR or a depth camera, relative.", default=0.0002)
    beam_elevation: Known = field("Of a LiDAR.", default=0.0002, unit="rad")
    arm_translation: Known = field("Of each moving link of an arm, each axis.", default=0.00005, unit="m")
    arm_rotation: Known = field("Of each moving link of an arm, each axis.", default=0.0001, unit="rad")


OF_INTRINSICS = ("focal_length", "aspect", "principal_point", "distortion")
"""Assumptions on fixed intrinsics; None for those of `calibration.engine.estimation.covariance.nominal_lens`."""
ALL_EXACT = Assumptions(**dict.fromkeys((each.name for each in fields(Assumptions)), 0.0))
"""All fixed parameters are exactly known."""
