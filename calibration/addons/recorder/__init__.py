"""Motion recorder: a web page on which poses are set by hand, previewed for every sensor, and saved."""

from calibration.base.addons import Addon, LazyCommand

ADDON = Addon(
    commands={
        "record-motion": LazyCommand(
            f"{__name__}.record_motion:command", "Record a motion sequence on a page in the browser."
        )
    }
)
