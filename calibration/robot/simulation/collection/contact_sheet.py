"""Contact sheet of all poses: the data and detections of each sensor, and the reasons of rejected poses."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from calibration.base.files import write_atomically
from calibration.robot.labelling.detection import Image
from calibration.robot.simulation.collection.record import Record
from calibration.robot.simulation.sensors.sensor import PICTURE_HEIGHT_PX
from calibration.robot.simulation.system import System

CONTACT_SHEET_FILE = "contact_sheet.png"
SHEET_WIDTH_PX = 1600
"""Approximate width of the sheet, px."""
MOST_POSES = 120
"""Limit of the number of poses shown."""
_GAP_PX, _LINE_HEIGHT_PX = 6, 16
_PAPER_COLOUR, _INK_COLOUR, _REJECTED_COLOUR = (250, 250, 250), (60, 60, 60), (40, 40, 200)
_FONT, _TEXT_SIZE = cv2.FONT_HERSHEY_SIMPLEX, 0.38


def write_contact_sheet(folder: Path, system: System, records: Sequence[Record], files: Path) -> None:
    """Write the contact sheet.

    Args:
        folder: folder of the sheet.
        system: the system.
        records: of every pose, including rejected ones.
        files: the folder with the images, depth images and clouds of the records.

    Raises:
        InfrastructureError: it cannot be written.
    """
    tiles = [_draw_pose(system, record, files) for record in records[:MOST_POSES]]
    columns = max(1, round(SHEET_WIDTH_PX / tiles[0].shape[1]))
    tiles += [np.full_like(tiles[0], _PAPER_COLOUR)] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    done, data = cv2.imencode(".png", np.vstack(rows), [cv2.IMWRITE_PNG_COMPRESSION, 4])
    if not done:
        raise AssertionError("OpenCV cannot write .png")
    write_atomically(folder / CONTACT_SHEET_FILE, bytes(data))


def _draw_pose(system: System, record: Record, files: Path) -> Image:
    """Draw one pose: its pictures side by side, each with a title; a rejected pose has a frame."""
    labels, parts = record.collection["labels"], []
    for name, sensor in system.by_modality:
        own = [by_sensor[name] for by_sensor in labels.values()]
        patterns = [system.patterns[pattern] for pattern in labels]
        picture = sensor.draw(record.collection["data"][name], own, patterns, files)
        if not record.kept:
            cv2.rectangle(picture, (0, 0), (picture.shape[1] - 1, PICTURE_HEIGHT_PX - 1), _REJECTED_COLOUR, 2)
        found = f"{record.labels[name]} {sensor.label_name}" if record.labels[name] else "not detected"
        part = np.vstack([_draw_text_line(f"{name}: {found}", picture.shape[1], _INK_COLOUR), picture])
        parts += [part, np.full((len(part), _GAP_PX, 3), _PAPER_COLOUR, np.uint8)]
    row = (
        np.hstack(parts)
        if parts
        else np.full((_LINE_HEIGHT_PX + PICTURE_HEIGHT_PX, SHEET_WIDTH_PX // 4, 3), _PAPER_COLOUR, np.uint8)
    )
    title = f"{record.number + 1}" if record.kept else f"{record.number + 1}  lost: {'; '.join(record.lost)}"
    heading = _draw_text_line(title, row.shape[1], _INK_COLOUR if record.kept else _REJECTED_COLOUR)
    return np.vstack([heading, row, np.full((_GAP_PX, row.shape[1], 3), _PAPER_COLOUR, np.uint8)])


def _draw_text_line(text: str, width: int, colour: tuple[int, int, int]) -> Image:
    """Draw a line of text, truncated to the width."""
    picture = np.full((_LINE_HEIGHT_PX, width, 3), _PAPER_COLOUR, np.uint8)
    cv2.putText(picture, text, (2, _LINE_HEIGHT_PX - 5), _FONT, _TEXT_SIZE, colour, 1, cv2.LINE_AA)
    return picture
