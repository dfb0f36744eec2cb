"""HTML fragments of the page: verdict, detections of a sensor, saved poses, rating.

Untrusted text (names, reasons) is escaped.
"""

import base64
import math
from collections.abc import Mapping, Sequence
from html import escape

import cv2
import numpy as np

from calibration.addons.recorder.preview import Preview, SensorPreview
from calibration.robot.labelling.detection import Image

GREEN, RED, GREY = "#2f9e44", "#e03131", "#868e96"
_THUMBNAIL_WIDTH = 76  # px
_MAX_THUMBNAILS = 16  # around the selected pose: four rows


def poses(count: int) -> str:
    """Format a number of poses."""
    return f"{count} pose{'' if count == 1 else 's'}"


def verdict(seen: Preview | None, is_old: bool = False) -> str:
    """Format the verdict on a pose in large type, with the reasons for a rejection below."""
    if seen is None:
        return _verdict_box(GREY, "Looking …", (), busy=True)
    if seen.kept:
        return _verdict_box(GREEN, "✓ Kept", ("Every sensor sees a pattern.",), busy=is_old)
    return _verdict_box(RED, "✗ Lost", seen.reasons, busy=is_old)


def _verdict_box(colour: str, word: str, lines: Sequence[str], busy: bool) -> str:
    reasons = "".join(f'<div style="font-size:0.85em;overflow-wrap:anywhere">{escape(line)}</div>' for line in lines)
    return (
        f'<div id="verdict" role="status" aria-live="polite" aria-busy="{str(busy).lower()}" '
        f'style="background:{colour};color:white;border-radius:6px;margin:0.4em 1em;padding:0.4em 0.8em;'
        f'opacity:{0.6 if busy else 1}">'
        f'<div style="font-size:1.7em;font-weight:700">{word}</div>{reasons}</div>'
    )


def finding(sensor: str, view: SensorPreview | None) -> str:
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


def message(text: str, bad: bool = False) -> str:
    """Format the result of the last action."""
    colour = RED if bad else GREY
    return (
        f'<div id="message" role="{"alert" if bad else "status"}" style="color:{colour};margin:0 1em;min-height:1.4em;'
        f'overflow-wrap:anywhere">{escape(text)}</div>'
    )


def sequence(verdicts: Sequence[bool | None], pictures: Sequence[Image | None], selected: int | None) -> str:
    """Format the saved poses as numbered pictures, framed in the colour of their verdicts."""
    if not verdicts:
        return '<div style="margin:0 1em;opacity:0.7">No pose is saved yet.</div>'
    lost, unknown = sum(kept is False for kept in verdicts), sum(kept is None for kept in verdicts)
    title = poses(len(verdicts)) + (f", {lost} would be lost" if lost else ", all kept" if not unknown else "")
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


def rating(sigmas: Mapping[str, tuple[float, float]], problem: str) -> str:
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
