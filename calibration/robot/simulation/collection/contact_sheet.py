"""Contact sheet of all poses: the data and detections of each sensor, and the reasons of rejected poses."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from calibration.base import write_atomically
from calibration.robot.labelling.detection import Image
from calibration.robot.simulation.collection.record import Record
from calibration.robot.simulation.sensors.camera import encode_image
from calibration.robot.simulation.sensors.sensor import PICTURE_HEIGHT_PX
from calibration.robot.simulation.system import System

CONTACT_SHEET_FILE = "contact_sheet.png"
SHEET_WIDTH_PX = 1600
"""Approximate width of the sheet, px."""
MOST_POSES = 120
"""Limit of the number of poses shown."""
GAP_PX, LINE_HEIGHT_PX = 6, 16
PAPER_COLOUR, INK_COLOUR, REJECTED_COLOUR = (250, 250, 250), (60, 60, 60), (40, 40, 200)
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
    write_atomically(
        folder / CONTACT_SHEET_FILE, encode_image(arrange_tiles(tiles), ".png", [cv2.IMWRITE_PNG_COMPRESSION, 4])
    )


def arrange_tiles(tiles: Sequence[Image]) -> Image:
    """Arrange tiles of one size in rows, on a sheet of about `SHEET_WIDTH_PX`."""
    columns = max(1, round(SHEET_WIDTH_PX / tiles[0].shape[1]))
    filled = [*tiles, *[np.full_like(tiles[0], PAPER_COLOUR)] * (-len(tiles) % columns)]
    return np.vstack([np.hstack(filled[i : i + columns]) for i in range(0, len(filled), columns)])


def _draw_pose(system: System, record: Record, files: Path) -> Image:
    """Draw one pose: its pictures side by side, each with a title; a rejected pose has a frame."""
    labels, parts = record.collection["labels"], []
    for name, sensor in system.by_modality:
        own = [by_sensor[name] for by_sensor in labels.values()]
        patterns = [system.patterns[pattern] for pattern in labels]
        picture = sensor.draw(record.collection["data"][name], own, patterns, files)
        if not record.kept:
            cv2.rectangle(picture, (0, 0), (picture.shape[1] - 1, PICTURE_HEIGHT_PX - 1), REJECTED_COLOUR, 2)
        found = f"{record.labels[name]} {sensor.label_name}" if record.labels[name] else "not detected"
        part = np.vstack([draw_text_line(f"{name}: {found}", picture.shape[1], INK_COLOUR), picture])
        parts += [part, np.full((len(part), GAP_PX, 3), PAPER_COLOUR, np.uint8)]
    row = (
        np.hstack(parts)
        if parts
        else np.full((LINE_HEIGHT_PX + PICTURE_HEIGHT_PX, SHEET_WIDTH_PX // 4, 3), PAPER_COLOUR, np.uint8)
    )
    title = f"{record.number + 1}" if record.kept else f"{record.number + 1}  lost: {'; '.join(record.lost)}"
    heading = draw_text_line(title, row.shape[1], INK_COLOUR if record.kept else REJECTED_COLOUR)
    return np.vstack([heading, row, np.full((GAP_PX, row.shape[1], 3), PAPER_COLOUR, np.uint8)])


def draw_text_line(text: str, width: int, colour: tuple[int, int, int]) -> Image:
    """Draw a line of text, truncated to the width."""
    picture = np.full((LINE_HEIGHT_PX, width, 3), PAPER_COLOUR, np.uint8)
    cv2.putText(picture, text, (2, LINE_HEIGHT_PX - 5), _FONT, _TEXT_SIZE, colour, 1, cv2.LINE_AA)
    return picture
