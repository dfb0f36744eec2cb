"""Panels of the page: their HTML, their widgets and the display of a session. The page handles the clicks.

Untrusted text (names, reasons) is escaped.
"""

import base64
import math
from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

import cv2
import numpy as np
import viser

from calibration.addons.recorder.preview import MAX_PICTURE_WIDTH, Preview, SensorPreview
from calibration.addons.recorder.session import Session
from calibration.base import count_of
from calibration.base.arrays import Array
from calibration.engine.geometry import rotations
from calibration.engine.geometry.cameras import Camera
from calibration.engine.geometry.transforms import from_xyz_rpy
from calibration.robot.labelling.detection import Image
from calibration.robot.simulation.system import System
from calibration.robot.urdf import Joint

GREEN, RED, GREY = "#2f9e44", "#e03131", "#868e96"
_THUMBNAIL_WIDTH = 76  # px
_MAX_THUMBNAILS = 16  # around the selected pose: four rows


def verdict_html(seen: Preview | None, is_old: bool = False) -> str:
    """Format the verdict on a pose in large type, with the reasons for a rejection below."""
    if seen is None:
        return _verdict_box_html(GREY, "Looking …", (), busy=True)
    if seen.kept:
        return _verdict_box_html(GREEN, "✓ Kept", ("Every sensor sees a pattern.",), busy=is_old)
    return _verdict_box_html(RED, "✗ Lost", seen.reasons, busy=is_old)


def _verdict_box_html(colour: str, word: str, lines: Sequence[str], busy: bool) -> str:
    reasons = "".join(f'<div style="font-size:0.85em;overflow-wrap:anywhere">{escape(line)}</div>' for line in lines)
    return (
        f'<div id="verdict" role="status" aria-live="polite" aria-busy="{str(busy).lower()}" '
        f'style="background:{colour};color:white;border-radius:6px;margin:0.4em 1em;padding:0.4em 0.8em;'
        f'opacity:{0.6 if busy else 1}">'
        f'<div style="font-size:1.7em;font-weight:700">{word}</div>{reasons}</div>'
    )


def finding_html(sensor: str, view: SensorPreview | None) -> str:
    """Format a sensor's name and its detections."""
    if view is None:
        mark, text, colour = "·", "", GREY
    else:
        mark, text = ("✓" if view.detected else "✗"), view.finding
        colour = GREEN if view.detected else RED
    return (
        f'<div style="margin:0.3em 1em 0;overflow-wrap:anywhere"><b style="color:{colour}">{mark} '
        f"{escape(sensor)}</b> <span>{escape(text)}</span></div>"
    )


def message_html(text: str, bad: bool = False) -> str:
    """Format the result of the last action."""
    colour = RED if bad else GREY
    return (
        f'<div id="message" role="{"alert" if bad else "status"}" style="color:{colour};margin:0 1em;min-height:1.4em;'
        f'overflow-wrap:anywhere">{escape(text)}</div>'
    )


def sequence_html(verdicts: Sequence[bool | None], pictures: Sequence[Image | None], selected: int | None) -> str:
    """Format the saved poses as numbered pictures, framed in the colour of their verdicts."""
    if not verdicts:
        return '<div style="margin:0 1em;opacity:0.7">No pose is saved yet.</div>'
    lost, unknown = sum(kept is False for kept in verdicts), sum(kept is None for kept in verdicts)
    title = count_of(len(verdicts), "pose") + (
        f", {lost} would be lost" if lost else ", all kept" if not unknown else ""
    )
    first = max(0, min((selected or 0) - _MAX_THUMBNAILS // 2, len(verdicts) - _MAX_THUMBNAILS))
    shown = range(first, min(first + _MAX_THUMBNAILS, len(verdicts)))
    if len(shown) < len(verdicts):
        title += f" (here {shown[0] + 1} to {shown[-1] + 1})"
    cells = "".join(_thumbnail_html(i + 1, verdicts[i], pictures[i], i == selected) for i in shown)
    return (
        f'<div style="margin:0 1em"><div id="count"><b>{title}</b></div>'
        f'<div style="display:flex;flex-wrap:wrap;gap:4px;margin-top:4px">{cells}</div></div>'
    )


def _thumbnail_html(number: int, kept: bool | None, picture: Image | None, is_selected: bool) -> str:
    colour = GREY if kept is None else GREEN if kept else RED
    word = "not looked at yet" if kept is None else "kept" if kept else "lost"
    image = "" if picture is None else f'<img alt="" src="{_data_url(picture)}" style="width:100%;display:block">'
    ring = f"outline:3px solid {colour};" if is_selected else ""
    return (
        f'<div role="img" aria-label="pose {number}, {word}" style="width:{_THUMBNAIL_WIDTH}px;min-height:1.6em;'
        f'border:3px solid {colour};border-radius:4px;position:relative;{ring}">{image}'
        f'<span style="position:absolute;left:0;top:0;background:{colour};color:white;padding:0 4px;font-size:0.8em;'
        f'font-weight:700">{number}</span></div>'
    )


def _data_url(picture: Image) -> str:
    height = max(1, round(picture.shape[0] * _THUMBNAIL_WIDTH / picture.shape[1]))
    small = cv2.resize(picture, (_THUMBNAIL_WIDTH, height), interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 75])
    return "data:image/jpeg;base64," + base64.b64encode(np.asarray(data).tobytes()).decode()


def rating_html(sigmas: Mapping[str, tuple[float, float]], problem: str) -> str:
    """Format the rating of the saved poses: the standard deviation of each sensor (m, rad)."""
    if problem:
        return f'<div id="rating" style="margin:0 1em;color:{RED};overflow-wrap:anywhere">{escape(problem)}</div>'
    if not sigmas:
        return '<div id="rating" style="margin:0 1em;opacity:0.7">Save poses to see what they determine.</div>'
    rows = "".join(
        f'<tr><td style="padding-right:1em">{escape(sensor)}</td><td>{_uncertainty_html(*sigma)}</td></tr>'
        for sensor, sigma in sigmas.items()
    )
    return (
        '<div id="rating" style="margin:0 1em">A calibration from these poses would be uncertain by (one sigma)'
        f"<table>{rows}</table></div>"
    )


def _uncertainty_html(translation: float, rotation: float) -> str:
    if not (math.isfinite(translation) and math.isfinite(rotation)):
        return f'<span style="color:{RED}">not determined</span>'
    if translation == rotation == 0:
        return "held fixed"
    return f"{1000 * translation:.2g} mm, {math.degrees(rotation):.2g}°"


_PANEL_WIDTH = 340  # px
_MAX_EQUAL_DIFFERENCE = 1e-6  # m, rad: smaller changes do not rewrite an input, so that typing is not disturbed
_SHOWN_M, _SHOWN_RAD = 1e-4, 3e-4  # resolution of the inputs of a pose, and of three angles together


class ViewsPanel:
    """Verdict, and below it the view of each sensor."""

    def __init__(self, gui: viser.GuiApi, system: System) -> None:
        self._seen: Preview | None = None
        panel = gui.add_panel()
        with panel.add_tab("Sensors", viser.Icon.EYE):
            self._verdict = gui.add_html(verdict_html(None))
            self._findings: dict[str, viser.GuiHtmlHandle] = {}
            self._pictures: dict[str, viser.GuiImageHandle] = {}
            for name, sensor in system.sensors.items():
                self._findings[name] = gui.add_html(finding_html(name, None))
                if sensor.intrinsics:
                    self._pictures[name] = gui.add_image(_blank_picture(sensor.intrinsics), jpeg_quality=85)
        self._blanks = {name: handle.image for name, handle in self._pictures.items()}
        panel.dock_left()
        panel.set_width(_PANEL_WIDTH)

    def wait(self) -> None:
        """Mark the views as outdated."""
        self._verdict.content = verdict_html(self._seen, is_old=True)

    def show(self, seen: Preview) -> None:
        """Show a preview."""
        self._seen = seen
        self._verdict.content = verdict_html(seen)
        for name, finding in self._findings.items():
            finding.content = finding_html(name, seen.views.get(name))
        for name, picture in self._pictures.items():
            view = seen.views.get(name)
            picture.image = self._blanks[name] if view is None or view.picture is None else view.picture


def _blank_picture(camera: Camera) -> Image:
    scale = min(1.0, MAX_PICTURE_WIDTH / camera.width)
    return np.full((max(1, round(camera.height * scale)), max(1, round(camera.width * scale)), 3), 222, np.uint8)


class PosePanel:
    """Current pose in numbers: of the moved pattern's model, and of the joints."""

    def __init__(
        self,
        gui: viser.GuiApi,
        system: System,
        edit_model: Callable[[Array], None],
        edit_joint: Callable[[str, float], None],
    ) -> None:
        """Add the inputs; an edit calls back with ``T_parent_model``, or a joint's name and position (rad or m)."""
        self._joints: dict[str, tuple[Joint, viser.GuiSliderHandle[float]]] = {}
        self._model: tuple[viser.GuiVector3Handle, viser.GuiVector3Handle] | None = None
        self._T_parent_model = np.eye(4)  # the pose that is shown
        moved = system.moved_pattern
        if moved is not None:
            hint = f"The model of {moved.name} in {moved.parent_link}"
            zero = (0.0, 0.0, 0.0)
            position = gui.add_vector3("Position (m)", zero, step=0.01, hint=f"{hint}: x, y, z")
            turn = gui.add_vector3("Turn (deg)", zero, step=1.0, hint=f"{hint}: roll, pitch, yaw")
            position.precision, turn.precision = 4, 2  # displayed digits; the session keeps full precision
            self._model = (position, turn)

            def edited(event: viser.GuiEvent[viser.GuiVector3Handle]) -> None:
                if event.client_id is not None and not self._is_shown(self._T_parent_model):
                    edit_model(self._shown_model())

            position.on_update(edited)
            turn.on_update(edited)
        for name, joint in system.robot.movable.items():
            self._joints[name] = (joint, self._add_slider(gui, joint, edit_joint))

    def show(self, session: Session) -> None:
        """Show the pose of a session."""
        model_poses = session.pose.model_poses
        if self._model is not None and model_poses is not None:
            position, turn = self._model
            T = self._T_parent_model = model_poses[0]
            if np.abs(T[:3, 3] - position.value).max() > _MAX_EQUAL_DIFFERENCE:
                _set_value(position, tuple(np.round(T[:3, 3], 6).tolist()))
            if rotations.angle(self._shown_model()[:3, :3].T @ T[:3, :3]) > 10 * _MAX_EQUAL_DIFFERENCE:
                _set_value(turn, tuple(np.round(np.degrees(rotations.to_rpy(T[:3, :3])), 4).tolist()))
        for name, (joint, slider) in self._joints.items():
            value = float(session.pose.joints[name][0]) * _display_unit(joint)[1]
            if abs(value - slider.value) > _MAX_EQUAL_DIFFERENCE:
                _set_value(slider, round(min(max(value, slider.min), slider.max), 4))

    def _is_shown(self, T_parent_model: Array) -> bool:
        """Return whether the inputs show this pose within their resolution: a browser returns rounded values."""
        shown = self._shown_model()
        apart = np.abs(T_parent_model[:3, 3] - shown[:3, 3]).max()
        return bool(apart < _SHOWN_M and rotations.angle(T_parent_model[:3, :3].T @ shown[:3, :3]) < _SHOWN_RAD)

    def _shown_model(self) -> Array:
        """Return ``T_parent_model`` of the inputs."""
        assert self._model is not None  # noqa: S101 (asked only where there are inputs)
        position, turn = self._model
        return from_xyz_rpy(position.value, np.radians(turn.value))

    def _add_slider(
        self, gui: viser.GuiApi, joint: Joint, edit_joint: Callable[[str, float], None]
    ) -> viser.GuiSliderHandle[float]:
        unit, scale = _display_unit(joint)
        low, high = max(joint.lower, -2 * math.pi) * scale, min(joint.upper, 2 * math.pi) * scale
        step = 0.001 if joint.kind == "prismatic" else 0.1
        # A joint with equal limits gets a non-empty range on the page; the session keeps its position.
        slider = gui.add_slider(f"{joint.name} ({unit})", low, max(high, low + step), step, joint.rest * scale)

        def edited(event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
            if event.client_id is not None:
                edit_joint(joint.name, slider.value / scale)

        slider.on_update(edited)
        return slider


def _set_value(handle: viser.GuiInputHandle[Any], value: Any) -> None:
    handle.value = value  # type: ignore[misc]  # its setter does not follow its getter, so mypy does not see it


def _display_unit(joint: Joint) -> tuple[str, float]:
    """Return the display unit of positions, and its number per metre or radian."""
    return ("m", 1.0) if joint.kind == "prismatic" else ("deg", 180 / math.pi)


class SequencePanel:
    """Saved poses, their actions, and the file."""

    def __init__(self, gui: viser.GuiApi, file: str) -> None:
        self._message = gui.add_html(message_html(""))
        self.save = gui.add_button(
            "Save pose", icon=viser.Icon.PLUS, color="green", hint="Add this pose to the end of the sequence"
        )
        with gui.add_folder("Sequence"):
            self._poses = gui.add_html(sequence_html((), (), None))
            self.choice = gui.add_dropdown("Pose", ("none",), hint="Go to a saved pose")
            self.play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="Step through the poses")
            self.replace = gui.add_button(
                "Replace by this pose",
                icon=viser.Icon.REPLACE,
                hint="Put the pose at hand in the place of the chosen one",
            )
            self.earlier = gui.add_button("Move earlier", icon=viser.Icon.ARROW_UP)
            self.later = gui.add_button("Move later", icon=viser.Icon.ARROW_DOWN)
            self.delete = gui.add_button("Delete pose", icon=viser.Icon.TRASH, color="red")
            self.undo = gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP, hint="Take the last change back")
        with gui.add_folder("What it determines"):
            self._rating = gui.add_html(rating_html({}, ""))
        with gui.add_folder("File"):
            self.file = gui.add_text("File name", file)
            self.export = gui.add_button("Export", icon=viser.Icon.DEVICE_FLOPPY, hint="Write the sequence to the file")
            self.download = gui.add_button("Download", icon=viser.Icon.DOWNLOAD, hint="Get the sequence in the browser")
            self.upload = gui.add_upload_button(
                "Load a sequence", icon=viser.Icon.UPLOAD, mime_type="application/json", hint="In place of this one"
            )
        with gui.add_folder("Show", expand_by_default=False):
            self.show_saved = gui.add_checkbox("Saved poses", True)
            self.show_frames = gui.add_checkbox("Frames of the links", False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_PANEL_WIDTH)

    def say(self, text: str, bad: bool = False) -> None:
        """Show the result of the last action."""
        self._message.content = message_html(text, bad)

    def rate(self, sigmas: Mapping[str, tuple[float, float]], problem: str = "") -> None:
        """Show the standard deviations from the sequence (m, rad), or why they are undetermined."""
        self._rating.content = rating_html(sigmas, problem)

    def show_poses(self, session: Session, verdicts: Sequence[bool | None], pictures: Sequence[Image | None]) -> None:
        """Show the saved poses with their verdicts and pictures."""
        self._poses.content = sequence_html(verdicts, pictures, session.selected)
        words = {None: "", True: " · kept", False: " · lost"}
        options = tuple(f"{number} of {len(verdicts)}{words[kept]}" for number, kept in enumerate(verdicts, 1))
        self.choice.options = options or ("none",)
        _set_value(self.choice, self.choice.options[session.selected or 0])

    def show_state(self, session: Session, playing: bool, replacing: str | None) -> None:
        """Enable the actions that are possible in the current state.

        Args:
            session: the session.
            playing: whether the sequence is being played.
            replacing: the file that a second click on the export replaces.
        """
        chosen, count = session.selected, len(session.poses)
        self.choice.disabled = self.play.disabled = self.export.disabled = self.download.disabled = not count
        self.delete.disabled = chosen is None
        self.replace.disabled = not session.is_changed
        self.earlier.disabled = not chosen
        self.later.disabled = chosen is None or chosen == count - 1
        self.undo.disabled = not session.can_undo
        self.play.label, self.play.icon = (
            ("Stop", viser.Icon.PLAYER_STOP) if playing else ("Play", viser.Icon.PLAYER_PLAY)
        )
        self.export.label = f"Replace {replacing}" if replacing else "Export"
        self.export.color = "orange" if replacing else None

    def chosen(self) -> int:
        """Return the index of the pose that is selected in the list."""
        return self.choice.options.index(self.choice.value)
