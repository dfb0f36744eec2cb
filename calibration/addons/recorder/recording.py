"""Server of the motion recorder, which runs until it is interrupted."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from calibration.addons.recorder.markup import poses
from calibration.addons.recorder.page import Page
from calibration.addons.recorder.preview import preview
from calibration.addons.recorder.server import address, is_loopback, serving
from calibration.addons.recorder.session import Session
from calibration.ci.workflow import Runner, stop_commands
from calibration.robot.simulation.motion.information import predicted_sigmas
from calibration.robot.simulation.motion.sequence import read_motion
from calibration.robot.simulation.system import read_system


@dataclass(frozen=True)
class RecorderInputs:
    """Input files of the recorder."""

    system: Path
    """Folder of the system."""
    robot: Path | None = None
    """URDF file that replaces the system's."""
    configuration: Path | None = None
    """ATOM calibration configuration that replaces the system's."""
    motion: Path | None = None
    """Initial sequence."""


def record(
    inputs: RecorderInputs,
    output: Path,
    host: str,
    port: int,
    runner: Runner,
    open_page: Callable[[str], object] | None = None,
    overwrite: bool = False,
) -> None:
    """Serve the page; on interruption, unsaved poses are written to a file beside the output.

    Args:
        inputs: the system that is shown, and the initial sequence.
        output: default file of the page's export.
        host: address to serve on.
        port: its port; 0 for a free one.
        runner: runner that logs the address.
        open_page: called with the address, to open it in a browser.
        overwrite: whether the page may replace motion files that it did not write.

    Raises:
        InputError: an input is missing or malformed.
        InfrastructureError: the port is taken, or a file cannot be written.
    """
    system = read_system(inputs.system, inputs.robot, inputs.configuration)
    session = Session(system, read_motion(inputs.motion) if inputs.motion else None)
    with serving(host, port) as server:
        page = Page(
            server,
            session,
            output,
            look=lambda pose: preview(system, pose),
            rate=lambda sequence: predicted_sigmas(system, sequence),
            overwrite=overwrite,
        )
        try:
            with stop_commands(runner):  # untrusted names from files
                runner.log(f"{system.name}: the motion recorder is at {address(server)} (Ctrl-C ends it)")
                if not is_loopback(host):
                    who = "everyone who has this address, which is not encrypted on its way,"
                    runner.log(f"{who} can use it and write motion files beside {output}")
            if open_page is not None:
                open_page(address(server))
            threading.Event().wait()
        finally:
            page.close()
            saved = session.autosave(output)
            if saved is not None:
                with stop_commands(runner):
                    runner.log(f"{poses(len(session.poses))} not exported, now in {saved}")
