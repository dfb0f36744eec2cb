"""Serves the page on which a motion is recorded, until the process is interrupted."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from calibration.recorder.markup import poses
from calibration.recorder.page import Page
from calibration.recorder.preview import preview
from calibration.recorder.server import address, is_loopback, serving
from calibration.recorder.session import Session
from calibration.simulation.motion.information import predicted_sigmas
from calibration.simulation.motion.sequence import read_motion
from calibration.simulation.system import read_system
from calibration.workflow import Runner, stop_commands


@dataclass(frozen=True)
class Inputs:
    """Files that are read before the page is served."""

    system: Path
    """Folder of the system."""
    robot: Path | None = None
    """URDF file in place of the system's."""
    configuration: Path | None = None
    """ATOM's calibration configuration in place of the system's."""
    motion: Path | None = None
    """Sequence to begin with."""


def record(
    inputs: Inputs,
    output: Path,
    host: str,
    port: int,
    runner: Runner,
    open_page: Callable[[str], object] | None = None,
) -> None:
    """Serve the page; when interrupted, poses that are in no file are written to one beside the output.

    Args:
        inputs: the robot that is shown, and the sequence to begin with.
        output: the file that the page exports to.
        host: address to serve on.
        port: its port; 0 for a free one.
        runner: where the address is reported.
        open_page: called with the address, to open it in a browser.

    Raises:
        InputError: an input is missing or wrong.
        WorldError: the port is taken, or a file cannot be written.
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
        )
        try:
            with stop_commands(runner):  # names in files that others wrote
                runner.log(f"{system.name}: the motion recorder is at {address(server)} (Ctrl-C ends it)")
                if not is_loopback(host):
                    runner.log(f"whoever reaches {host} can use it and write files beside {output}")
            if open_page is not None:
                open_page(address(server))
            threading.Event().wait()
        finally:
            page.close()
            saved = session.autosave(output)
            if saved is not None:
                with stop_commands(runner):
                    runner.log(f"{poses(len(session.poses))} not exported, now in {saved}")
