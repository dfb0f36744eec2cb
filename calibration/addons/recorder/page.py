"""The page: a 3D scene in the centre, the sensors' views on the left, pose and sequence on the right.

Callbacks run in the server's threads, previews are made in a thread of our own. The lock protects
the session and the panels; previews are computed without it, for the newest pose only.
"""

import math
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Generic, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import viser

from calibration.addons.recorder.panels import PosePanel, SequencePanel, ViewsPanel
from calibration.addons.recorder.preview import Preview
from calibration.addons.recorder.scene import KEPT_COLOUR, LOST_COLOUR, UNKNOWN_COLOUR, RobotScene, view_point
from calibration.addons.recorder.session import Session, joined
from calibration.base import CalibrationError, InputError, count_of, temporary_folder
from calibration.base.arrays import Array
from calibration.engine.geometry.transforms import from_quaternion
from calibration.robot.labelling.detection import Image
from calibration.robot.simulation.kinematics import place
from calibration.robot.simulation.motion import Motion, read_motion

Item = TypeVar("Item")


class Newest(Generic[Item]):
    """Worker thread with a queue of length one: a newer request replaces a waiting one."""

    def __init__(self, work: Callable[[Item], None], spare: Callable[[], bool] = lambda: False) -> None:
        """Start the thread.

        Args:
            work: called with a request. It must not raise: an error ends the thread.
            spare: called repeatedly while no request waits, until it returns False; then it is
                called again after the next request or `wake`.
        """
        self._work, self._spare = work, spare
        self._condition = threading.Condition()
        self._waiting: list[Item] = []  # one at most
        self._awake = True
        self._closed = False
        self._thread = threading.Thread(target=self._run_until_closed, name=f"newest {work.__name__}", daemon=True)
        self._thread.start()

    def ask(self, item: Item) -> None:
        """Request work on an item, in place of one that still waits."""
        with self._condition:
            self._waiting = [item]
            self._condition.notify()

    def wake(self) -> None:
        """Notify the thread of new spare work."""
        with self._condition:
            self._awake = True
            self._condition.notify()

    def close(self) -> None:
        """Stop the thread after its current work, and wait for it."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run_until_closed(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._waiting or self._awake or self._closed)
                if self._closed:
                    return
                items, self._waiting = self._waiting, []
                if not items:
                    self._awake = False
            for item in items:
                self._work(item)
            if self._spare():
                self.wake()


PLAY_PAUSE = 1.0
"""Pause between two poses of a sequence that is played, s."""

FIELD_OF_VIEW = math.radians(60)
"""Initial vertical field of view of the scene, rad."""

MAX_NAME = 60
"""Limit of a file name in characters; a file system's limit is 255 bytes, and a character takes up to four."""

Look = Callable[[Motion], Preview]
"""Function that returns the preview of a pose. Slow."""
Rate = Callable[[Motion], Mapping[str, tuple[float, float]]]
"""Function that returns each sensor's standard deviation for a motion (m, rad). Slow; may raise `InputError`."""


class Page:
    """The recorder's page on a server; all browsers share one session."""

    def __init__(
        self, server: viser.ViserServer, session: Session, output: Path, look: Look, rate: Rate, overwrite: bool = False
    ) -> None:
        """Build the page.

        Args:
            server: where the page is built.
            session: what it shows and changes.
            output: default of the file to export to.
            look: makes the preview of a pose.
            rate: rates the sequence.
            overwrite: whether a file that the session did not write may be replaced, by a second click.
        """
        self._server, self._session, self._output, self._overwrite = server, session, output, overwrite
        self._look, self._rate = look, rate
        self._lock = threading.RLock()
        self._seen: WeakKeyDictionary[Motion, Preview] = WeakKeyDictionary()  # previews of saved poses
        self._rated: tuple[Motion, ...] | None = None  # the sequence whose rating is shown
        self._shown: object = None  # the state of the sequence that is shown
        self._dragging = False
        self._replacing: Path | None = None  # the file that a second click on the export replaces
        self._stop_playing: threading.Event | None = None  # while the sequence is played
        with self._lock:
            server.gui.configure_theme(show_logo=False, show_share_button=False)
            self._scene = RobotScene(server.scene, session.system, session.placement, session.handle_pose())
            self._views = ViewsPanel(server.gui, session.system)
            self._numbers = PosePanel(server.gui, session.system, self._edit_model, self._edit_joint)
            self._sequence = SequencePanel(server.gui, output.name)
            position, look_at = view_point(session.system, session.placement)
            server.initial_camera.position, server.initial_camera.look_at = position, look_at
            server.initial_camera.fov = FIELD_OF_VIEW
            self._looking = Newest(self._look_at, spare=self._look_at_others)
            self._following = Newest(self._follow_handle)
            self._connect_controls()
            self._refresh_page()

    def close(self) -> None:
        """Stop the background threads, and wait for them."""
        with self._lock:
            if self._stop_playing is not None:
                self._stop_playing.set()
        self._following.close()
        self._looking.close()

    # User actions

    def _connect_controls(self) -> None:
        panel, session = self._sequence, self._session
        for button, action in (
            (panel.save, session.save),
            (panel.replace, session.replace_selected),
            (panel.delete, session.delete_selected),
            (panel.earlier, lambda: session.shift_selected(-1)),
            (panel.later, lambda: session.shift_selected(1)),
            (panel.undo, session.undo),
        ):
            button.on_click(self._callback_of(action))
        panel.choice.on_update(self._choose_pose)
        panel.play.on_click(lambda _: self._play_sequence())
        panel.export.on_click(lambda _: self._export_sequence())
        panel.download.on_click(self._download_sequence)
        panel.upload.on_upload(lambda _: self._load_upload())
        panel.show_saved.on_update(lambda _: self._show_extras())
        panel.show_frames.on_update(lambda _: self._show_extras())
        if self._scene.gizmo is not None:
            self._scene.gizmo.on_update(self._grip)

    def _callback_of(self, action: Callable[[], None]) -> Callable[[object], None]:
        """Return a callback that changes the session and refreshes the page."""

        def do(_event: object) -> None:
            with self._hold_for_change():
                action()

        return do

    @contextmanager
    def _hold_for_change(self) -> Iterator[None]:
        """Hold the lock for a change, then show the new state or the error."""
        with self._lock:
            self._sequence.say("")
            self._replacing = None
            try:
                yield
            except CalibrationError as error:
                self._sequence.say(str(error), bad=True)
            self._refresh_page()

    def _edit_model(self, T_parent_model: Array) -> None:
        with self._hold_for_change():
            self._session.move_model(T_parent_model)

    def _edit_joint(self, name: str, position: float) -> None:
        with self._hold_for_change():
            self._session.move_joints({name: position})

    async def _grip(self, event: viser.TransformControlsEvent) -> None:
        """Handle a drag event. Called in order and often, so it only queues a request."""
        self._dragging = event.phase != "end"
        handle = event.target
        self._following.ask(from_quaternion(handle.position, np.roll(handle.wxyz, -1)))

    def _follow_handle(self, T_world_handle: Array) -> None:
        with self._hold_for_change():
            if not self._session.drag(T_world_handle):
                self._sequence.say("No joint positions bring the handle there.", bad=True)

    def _choose_pose(self, event: viser.GuiEvent[Any]) -> None:
        if event.client_id is None:  # event caused by the page itself
            return
        with self._lock:
            poses, chosen = self._session.poses, self._sequence.chosen()
            if not poses or (chosen == self._session.selected and self._session.pose is poses[chosen]):
                return  # echo of a value that the page has set
            with self._hold_for_change():
                self._session.select(chosen)

    def _play_sequence(self) -> None:
        """Step through the poses; a second call stops."""
        with self._lock:
            if self._stop_playing is not None:
                self._stop_playing.set()
                return
            self._stop_playing = stop = threading.Event()
        for index in range(len(self._session.poses)):
            with self._hold_for_change():
                if stop.is_set() or index >= len(self._session.poses):
                    break
                self._session.select(index)
            stop.wait(PLAY_PAUSE)
        with self._hold_for_change():
            self._stop_playing = None

    def _export_sequence(self) -> None:
        with self._lock:
            sure = self._replacing
            with self._hold_for_change():
                path = beside(self._output, self._sequence.file.value)
                if not self._session.poses or sure == path or self._session.may_write(path):
                    self._session.export(path, replace_file=sure == path)
                    self._sequence.say(f"{count_of(len(self._session.poses), 'pose')} written to {path}")
                elif not self._overwrite:
                    advice = "give another name, or start the recorder with --overwrite"
                    raise InputError(f"{path.name} exists already; {advice}")
                else:
                    self._replacing = path
                    question = f"{path.name} exists already. Click again to replace it, or give another name."
                    self._sequence.say(question, bad=True)

    def _download_sequence(self, event: viser.GuiEvent[Any]) -> None:
        with self._hold_for_change():
            content = self._session.text().encode()
            if event.client is not None:
                event.client.send_file_download(
                    beside(self._output, self._sequence.file.value).name, content, save_immediately=True
                )

    def _load_upload(self) -> None:
        with self._hold_for_change():
            uploaded = self._sequence.upload.value
            self._session.load(parsed(uploaded.name, uploaded.content))
            self._sequence.say(f"{count_of(len(self._session.poses), 'pose')} loaded from {uploaded.name}")

    # Display; the lock is held

    def _refresh_page(self) -> None:
        """Show the current state of the session, and request a preview."""
        session = self._session
        with self._server.atomic():
            self._scene.show(session.placement, None if self._dragging else session.handle_pose())
            self._numbers.show(session)
            self._views.wait()
            self._show_sequence()
            replacing = None if self._replacing is None else self._replacing.name
            self._sequence.show_state(session, self._stop_playing is not None, replacing)
        self._looking.ask(session.pose)

    def _show_sequence(self) -> None:
        """Update the saved poses and their verdicts, if they have changed."""
        session = self._session
        verdicts = [seen.kept if (seen := self._seen.get(pose)) else None for pose in session.poses]
        content = (session.poses, session.selected, verdicts)
        if content == self._shown:
            return
        self._shown = content
        self._sequence.show_poses(session, verdicts, [self._picture_of_pose(pose) for pose in session.poses])
        colours = {None: UNKNOWN_COLOUR, True: KEPT_COLOUR, False: LOST_COLOUR}
        self._scene.show_saved(
            [
                (outline, colours[kept])
                for pose, kept in zip(session.poses, verdicts, strict=True)
                for outline in self._scene.outlines(place(session.system, pose))
            ]
        )
        self._show_extras()

    def _show_extras(self) -> None:
        self._scene.show_extras(frames=self._sequence.show_frames.value, saved=self._sequence.show_saved.value)

    def _picture_of_pose(self, pose: Motion) -> Image | None:
        """Return the first camera's picture at a saved pose, if it is known."""
        seen = self._seen.get(pose)
        views = seen.views.values() if seen else ()
        return next((view.picture for view in views if view.picture is not None), None)

    # Background threads

    def _look_at(self, pose: Motion) -> None:
        """Compute and show the preview of the current pose."""
        seen = self._seen.get(pose) or self._preview_of_pose(pose)
        with self._lock:
            if pose is not self._session.pose:
                return  # a newer request is already waiting
            with self._server.atomic():
                self._views.show(seen)
                self._scene.show_views(seen.views)
                if pose in self._session.poses:
                    self._seen[pose] = seen
                    self._show_sequence()

    def _preview_of_pose(self, pose: Motion) -> Preview:
        """Return the preview of a pose. A bug is reported, so that the thread and unsaved work survive."""
        try:
            return self._look(pose)
        except Exception:
            traceback.print_exc()
            return Preview({}, ("a bug, please report it with the output in the terminal",))

    def _look_at_others(self) -> bool:
        """Preview one saved pose, or else rate the sequence; return whether there was anything to do."""
        with self._lock:
            poses = self._session.poses
            pose = next((pose for pose in poses if pose not in self._seen), None)
            if pose is None and poses is self._rated:
                return False
        if pose is not None:
            seen = self._preview_of_pose(pose)
            with self._lock, self._server.atomic():
                self._seen[pose] = seen
                self._show_sequence()
            return True
        sigmas, problem = self._rate_sequence(poses)
        with self._lock:
            self._rated = poses
            self._sequence.rate(sigmas, problem)
        return True

    def _rate_sequence(self, poses: tuple[Motion, ...]) -> tuple[Mapping[str, tuple[float, float]], str]:
        """Return the standard deviations from the poses, or the reason why they are undetermined."""
        try:
            return (self._rate(joined(poses)) if poses else {}), ""
        except InputError as error:
            return {}, str(error)


def beside(output: Path, name: str) -> Path:
    """Return the motion file with that name in the output's folder, so that a page cannot write anything else.

    Raises:
        InputError: the name is not that of the output and not the plain name of a JSON file.
    """
    name = name.strip() or output.name
    is_motion = name == output.name or (name.endswith(".json") and not name.startswith("."))
    if not is_motion or Path(name).name != name or not name.isprintable() or len(name) > MAX_NAME:
        expected = f"a name of at most {MAX_NAME} characters that ends with .json, without a folder"
        raise InputError(f"File name: found '{name[:MAX_NAME]}', expected {expected}")
    return output.with_name(name)


def parsed(name: str, content: bytes) -> Motion:
    """Parse a motion from the content of a file.

    Raises:
        InputError: see `read_motion`.
    """
    with temporary_folder() as folder:
        path = folder / "motion.json"
        path.write_bytes(content)
        try:
            motion = read_motion(path)
        except InputError as error:
            raise InputError(str(error).replace(str(path), name)) from None
    return replace(motion, source=name)
