"""The page: a 3D scene in the middle, what the sensors see on the left, the pose and the sequence on the right.

Callbacks come from the server's threads, pictures from a thread of our own. Whoever reads or changes
the session or a panel holds the lock; sensors are looked through without it, for the newest pose only.
"""

import math
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import viser

from calibration.errors import CalibrationError, InputError
from calibration.geometry.transforms import from_quaternion
from calibration.geometry.types import Array
from calibration.labelling.detection import Image
from calibration.recorder import markup
from calibration.recorder.newest import Newest
from calibration.recorder.panels import PosePanel, SequencePanel, ViewsPanel
from calibration.recorder.preview import Preview
from calibration.recorder.scene import KEPT, LOST, UNKNOWN, RobotScene, view_point
from calibration.recorder.session import Session, joined
from calibration.simulation.motion.sequence import Motion, read_motion
from calibration.simulation.placement import place

PAUSE = 1.0
"""Between two poses of a sequence that is played, s."""

FIELD_OF_VIEW = math.radians(60)
"""Of who looks at the scene at first, from its top to its bottom, rad."""

MAX_NAME = 60
"""Of a file, characters; a file system takes 255 bytes, among them up to four a character."""

Look = Callable[[Motion], Preview]
"""What is seen at a pose. Takes time."""
Rate = Callable[[Motion], Mapping[str, tuple[float, float]]]
"""How well a motion determines each sensor (m, rad). Takes time; raises `InputError` where it does not."""


class Page:
    """The recorder's page on a server, for as many browsers as open it: all see and change the same session."""

    def __init__(self, server: viser.ViserServer, session: Session, output: Path, look: Look, rate: Rate) -> None:
        """Build the page; ``output`` is the file to export to unless the user gives another name."""
        self._server, self._session, self._output = server, session, output
        self._look, self._rate = look, rate
        self._lock = threading.RLock()
        self._seen: WeakKeyDictionary[Motion, Preview] = WeakKeyDictionary()  # of saved poses
        self._rated: tuple[Motion, ...] | None = None  # the sequence whose rating is shown
        self._shown: object = None  # what of the sequence is shown
        self._dragging = False
        self._replacing: Path | None = None  # what a second click on the export replaces
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
            self._following = Newest(self._follow)
            self._connect()
            self._refresh()

    def close(self) -> None:
        """Stop what runs in the background, and wait for it."""
        with self._lock:
            if self._stop_playing is not None:
                self._stop_playing.set()
        self._following.close()
        self._looking.close()

    # What the user does

    def _connect(self) -> None:
        panel, session = self._sequence, self._session
        for button, action in (
            (panel.save, session.save),
            (panel.replace, session.replace_selected),
            (panel.delete, session.delete_selected),
            (panel.earlier, lambda: session.shift_selected(-1)),
            (panel.later, lambda: session.shift_selected(1)),
            (panel.undo, session.undo),
        ):
            button.on_click(self._doing(action))
        panel.choice.on_update(self._choose)
        panel.play.on_click(lambda _: self._play())
        panel.export.on_click(lambda _: self._export())
        panel.download.on_click(self._download)
        panel.upload.on_upload(lambda _: self._upload())
        panel.show_saved.on_update(lambda _: self._show_extras())
        panel.show_frames.on_update(lambda _: self._show_extras())
        if self._scene.gizmo is not None:
            self._scene.gizmo.on_update(self._grip)

    def _doing(self, action: Callable[[], None]) -> Callable[[object], None]:
        """A callback that does something with the session and shows what has become of it."""

        def do(_event: object) -> None:
            with self._changing():
                action()

        return do

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Hold the lock for a change, and show what came of it: the new state, or what went wrong."""
        with self._lock:
            self._sequence.say("")
            self._replacing = None
            try:
                yield
            except CalibrationError as error:
                self._sequence.say(str(error), bad=True)
            self._refresh()

    def _edit_model(self, T_parent_model: Array) -> None:
        with self._changing():
            self._session.move_model(T_parent_model)

    def _edit_joint(self, name: str, position: float) -> None:
        with self._changing():
            self._session.move_joints({name: position})

    async def _grip(self, event: viser.TransformControlsEvent) -> None:
        """The handle is dragged. Called in order and often, so it does no more than to ask."""
        self._dragging = event.phase != "end"
        handle = event.target
        self._following.ask(from_quaternion(handle.position, np.roll(handle.wxyz, -1)))

    def _follow(self, T_world_handle: Array) -> None:
        with self._changing():
            if not self._session.drag(T_world_handle):
                self._sequence.say("No joint positions bring the handle there.", bad=True)

    def _choose(self, event: viser.GuiEvent[Any]) -> None:
        if event.client_id is None:  # the page itself has changed the list
            return
        with self._lock:
            poses, chosen = self._session.poses, self._sequence.chosen()
            if not poses or (chosen == self._session.selected and self._session.pose is poses[chosen]):
                return  # the browser answers to what the page has set
            with self._changing():
                self._session.select(chosen)

    def _play(self) -> None:
        """Step through the poses; a second call stops it."""
        with self._lock:
            if self._stop_playing is not None:
                self._stop_playing.set()
                return
            self._stop_playing = stop = threading.Event()
        for index in range(len(self._session.poses)):
            with self._changing():
                if stop.is_set() or index >= len(self._session.poses):
                    break
                self._session.select(index)
            stop.wait(PAUSE)
        with self._changing():
            self._stop_playing = None

    def _export(self) -> None:
        with self._lock:
            sure = self._replacing
            with self._changing():
                path = beside(self._output, self._sequence.file.value)
                if not self._session.poses or sure == path or self._session.may_write(path):
                    self._session.export(path, replace_file=True)
                    self._sequence.say(f"{markup.poses(len(self._session.poses))} written to {path}")
                else:
                    self._replacing = path
                    question = f"{path.name} exists already. Click again to replace it, or give another name."
                    self._sequence.say(question, bad=True)

    def _download(self, event: viser.GuiEvent[Any]) -> None:
        with self._changing():
            content = self._session.text().encode()
            if event.client is not None:
                event.client.send_file_download(
                    beside(self._output, self._sequence.file.value).name, content, save_immediately=True
                )

    def _upload(self) -> None:
        with self._changing():
            uploaded = self._sequence.upload.value
            self._session.load(parsed(uploaded.name, uploaded.content))
            self._sequence.say(f"{markup.poses(len(self._session.poses))} loaded from {uploaded.name}")

    # What the page shows; the lock is held

    def _refresh(self) -> None:
        """Show the session as it is now, and ask what the sensors see of it."""
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
        """Show the saved poses and what is known of them, if that has changed."""
        session = self._session
        verdicts = [seen.kept if (seen := self._seen.get(pose)) else None for pose in session.poses]
        content = (session.poses, session.selected, verdicts)
        if content == self._shown:
            return
        self._shown = content
        self._sequence.show_poses(session, verdicts, [self._picture(pose) for pose in session.poses])
        colours = {None: UNKNOWN, True: KEPT, False: LOST}
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

    def _picture(self, pose: Motion) -> Image | None:
        """What the first camera sees at a saved pose, if it is known."""
        seen = self._seen.get(pose)
        views = seen.views.values() if seen else ()
        return next((view.picture for view in views if view.picture is not None), None)

    # In the background

    def _look_at(self, pose: Motion) -> None:
        """Look at the pose at hand."""
        seen = self._seen.get(pose) or self._looked(pose)
        with self._lock:
            if pose is not self._session.pose:
                return  # the newer one is asked for already
            with self._server.atomic():
                self._views.show(seen)
                self._scene.show_views(seen.views)
                if pose in self._session.poses:
                    self._seen[pose] = seen
                    self._show_sequence()

    def _looked(self, pose: Motion) -> Preview:
        """What is seen at a pose. A bug in there is told, and takes neither the thread nor anybody's work along."""
        try:
            return self._look(pose)
        except Exception:
            traceback.print_exc()
            return Preview({}, ("a bug: the terminal says more, please report it",))

    def _look_at_others(self) -> bool:
        """Look at a saved pose that was not looked at yet, or else rate the sequence; whether one of these was left."""
        with self._lock:
            poses = self._session.poses
            pose = next((pose for pose in poses if pose not in self._seen), None)
            if pose is None and poses is self._rated:
                return False
        if pose is not None:
            seen = self._looked(pose)
            with self._lock, self._server.atomic():
                self._seen[pose] = seen
                self._show_sequence()
            return True
        sigmas, problem = self._rating(poses)
        with self._lock:
            self._rated = poses
            self._sequence.rate(sigmas, problem)
        return True

    def _rating(self, poses: tuple[Motion, ...]) -> tuple[Mapping[str, tuple[float, float]], str]:
        """How well the poses determine the calibration, or why they do not."""
        try:
            return (self._rate(joined(poses)) if poses else {}), ""
        except InputError as error:
            return {}, str(error)


def beside(output: Path, name: str) -> Path:
    """The file of that name in the output's folder, so that no page from elsewhere makes us write anywhere.

    Raises:
        InputError: it is not the name of a file.
    """
    name = name.strip() or output.name
    if Path(name).name != name or name == ".." or not name.isprintable() or len(name) > MAX_NAME:
        expected = f"a name of at most {MAX_NAME} characters, without a folder"
        raise InputError(f"File name: found '{name[:MAX_NAME]}', expected {expected}")
    return output.with_name(name)


def parsed(name: str, content: bytes) -> Motion:
    """A motion from the content of a file.

    Raises:
        InputError: see `read_motion`.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "motion.json")
        path.write_bytes(content)
        try:
            motion = read_motion(path)
        except InputError as error:
            raise InputError(str(error).replace(str(path), name)) from None
    return replace(motion, source=name)
