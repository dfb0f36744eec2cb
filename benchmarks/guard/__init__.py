"""The guard of fixed cameras: false red, planted shifts that are found, when, and what cannot be told.

A clip is 6 s of a textured room (`benchmarks.guard.clips`); 20 clips have a room and its reference in common.
"""

import math
import resource
import time
from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.guard import edges, lidars, witnessed
from benchmarks.guard.clips import Clip, Displacement, Disturbances, Room, as_recorded, camera_of_room
from benchmarks.rows import Bar, Row
from calibration.addons.guard.features import KeptCamera
from calibration.addons.guard.fixed_check import check_fixed_camera, kept_camera
from calibration.addons.guard.outcome import SensorCheck
from calibration.robot.labelling.detection import Image

CLIP_SECONDS = 6.0
CLIPS_PER_ROOM = 20
SMALLEST_PX, LARGEST_PX = 0.05, 40.0
"""px: sizes of planted shifts, evenly in their logarithm."""
MOST_FOUND_LATE_S = 1.0
MIN_FOUND_SIGMAS = 5
"""Stated standard deviations from which on a planted shift must be found."""


class Planted(NamedTuple):
    """A planted shift, and what was found."""

    shift_px: float
    since: float
    found: SensorCheck

    @property
    def is_red(self) -> bool:
        """Whether the check reports a displacement that begins within `MOST_FOUND_LATE_S` of the planted one."""
        at = self.found.since
        return self.found.red and at is not None and abs(at - self.since) <= MOST_FOUND_LATE_S

    @property
    def sigmas(self) -> float:
        """Its size in stated standard deviations."""
        stated = max(self.found.rotation_sigma_deg) if self.found.rotation_sigma_deg else math.inf
        return math.degrees(self.shift_px / camera_of_room().fx) / stated


def measure(quick: bool) -> Iterator[Row]:
    """False red, power, the smallest shift, what cannot be told, and the time of a two-minute clip."""
    unmoved, planted, untold = (60, 60, 18) if quick else (1000, 500, 200)
    red = [check for check in unmoved_clips(range(unmoved)) if check.outcome != "unmoved"]
    note = f"{len(red)} of {unmoved} clips with people, light, noise, compression, moved things"
    yield Row("guard/fixed/false red", 100 * len(red) / unmoved, "%", Bar(high=0.1), note)
    shifts = list(planted_shifts(range(planted)))
    clear = [each for each in shifts if each.sigmas >= MIN_FOUND_SIGMAS]
    found = sum(each.is_red for each in clear)
    note = f"{found} of {len(clear)} shifts of {MIN_FOUND_SIGMAS} and more sigma, within {MOST_FOUND_LATE_S:g} s"
    yield Row("guard/fixed/found", 100 * found / len(clear), "%", Bar(low=99), note)
    yield Row("guard/fixed/smallest in 99 %", smallest_found(shifts), "px", Bar(high=0.5), "and all above")
    checks = list(untold_clips(range(untold)))
    told = [each for each in checks if each.outcome != "cannot-tell"]
    note = "black, bare, another room, all moves, a camera that is waved, one that is covered"
    yield Row("guard/fixed/cannot tell, said so", 100 * (1 - len(told) / untold), "%", Bar(low=100), note)
    yield from _time_of_two_minutes()
    yield from witnessed.measure(quick)
    yield from lidars.measure(quick)
    yield from edges.measure(quick)


def reference_of(room: Room, seed: int) -> KeptCamera:
    """Return the reference of a room, of a clip of its own."""
    images = list(Clip(room, Displacement(), None, 10.0, Disturbances(moved_objects=0), seed).images())
    return kept_camera("room", "camera", room.camera, as_recorded(images), "0" * 64)


def _clips_of_rooms(seeds: range) -> Iterator[tuple[int, Room, KeptCamera, np.random.Generator]]:
    """Yield a seed, its room with its reference, and its random numbers."""
    known: tuple[int, Room, KeptCamera] | None = None
    for seed in seeds:
        number = seed // CLIPS_PER_ROOM
        if known is None or known[0] != number:
            room = Room.drawn(np.random.default_rng([1, number]))
            known = number, room, reference_of(room, 10_000 + number)
        yield seed, known[1], known[2], np.random.default_rng([2, seed])


def _drawn_disturbances(random: np.random.Generator) -> Disturbances:
    return Disturbances(
        people=int(random.integers(0, 5)),
        light=float(random.uniform(0.1, 0.6)),
        noise=float(random.uniform(1, 8)),
        quality=int(random.integers(40, 95)),
        shadows=int(random.integers(0, 5)),
        moved_objects=int(random.integers(0, 3)),
    )


def _check_of_images(kept: KeptCamera, images: list[Image]) -> SensorCheck:
    return check_fixed_camera(kept, as_recorded(images))


def unmoved_clips(seeds: range) -> Iterator[SensorCheck]:
    """Yield what is said of clips in which the camera stands still."""
    for seed, room, kept, random in _clips_of_rooms(seeds):
        clip = Clip(room, Displacement(), None, CLIP_SECONDS, _drawn_disturbances(random), seed)
        yield _check_of_images(kept, list(clip.images()))


def planted_shifts(seeds: range) -> Iterator[Planted]:
    """Yield what is found of rotations about any axis, in the middle of a clip."""
    for seed, room, kept, random in _clips_of_rooms(seeds):
        size = float(np.exp(random.uniform(math.log(SMALLEST_PX), math.log(LARGEST_PX))))
        axis = random.normal(size=3)
        rotation = np.degrees(size / room.camera.fx) * axis / np.linalg.norm(axis)
        since = float(random.integers(4, 9)) / 2
        moved = Displacement(rotation_deg=tuple(rotation.tolist()))
        clip = Clip(room, moved, since, CLIP_SECONDS, _drawn_disturbances(random), seed)
        yield Planted(size, since, _check_of_images(kept, list(clip.images())))


def smallest_found(shifts: list[Planted]) -> float:
    """Return the smallest size from which on 99 % of shifts are found."""
    ordered = sorted(shifts, key=lambda each: -each.shift_px)
    missed = np.cumsum([not each.is_red for each in ordered])
    good = np.flatnonzero(missed <= 0.01 * np.arange(1, len(ordered) + 1))
    return ordered[int(good[-1])].shift_px if len(good) else math.inf


def untold_clips(seeds: range) -> Iterator[SensorCheck]:
    """Yield what is said of clips of which nothing can be told."""
    kinds = (
        _black_images,
        _images_without_texture,
        _images_of_another_room,
        _images_of_many_rooms,
        _images_of_waved_camera,
        _images_of_covered_lens,
    )
    for seed, room, kept, random in _clips_of_rooms(seeds):
        yield _check_of_images(kept, kinds[seed % len(kinds)](room, seed, random))


def _images_of_still_camera(room: Room, seed: int, seconds: float = CLIP_SECONDS) -> list[Image]:
    return list(Clip(room, Displacement(), None, seconds, Disturbances(), seed).images())


def _black_images(room: Room, seed: int, random: np.random.Generator) -> list[Image]:
    return [
        np.clip(random.normal(2, 1.5, image.shape), 0, 255).astype(np.uint8)
        for image in _images_of_still_camera(room, seed)
    ]


def _images_without_texture(room: Room, seed: int, random: np.random.Generator) -> list[Image]:
    return [np.asarray(cv2.GaussianBlur(image, (0, 0), 40), np.uint8) for image in _images_of_still_camera(room, seed)]


def _images_of_another_room(room: Room, seed: int, random: np.random.Generator) -> list[Image]:
    return _images_of_still_camera(Room.drawn(random), seed)


def _images_of_many_rooms(room: Room, seed: int, random: np.random.Generator) -> list[Image]:
    return [_images_of_still_camera(Room.drawn(random), seed + i, 0.5)[0] for i in range(round(2 * CLIP_SECONDS))]


def _images_of_waved_camera(room: Room, seed: int, random: np.random.Generator) -> list[Image]:
    turns = random.normal(0, 1.5, (round(2 * CLIP_SECONDS), 3)).tolist()
    clips = (Clip(room, Displacement(rotation_deg=tuple(turn)), 0.0, 0.5, Disturbances(), seed) for turn in turns)
    return [next(clip.images()) for clip in clips]


def _images_of_covered_lens(room: Room, seed: int, random: np.random.Generator) -> list[Image]:
    images = _images_of_still_camera(room, seed)
    return [image if i < len(images) / 2 else np.full_like(image, 30) for i, image in enumerate(images)]


def _time_of_two_minutes() -> Iterator[Row]:
    seed, room, kept, _ = next(_clips_of_rooms(range(1)))
    turned = Displacement(rotation_deg=(0, 0.3, 0))
    images = list(Clip(room, turned, 60.0, 120.0, Disturbances(), seed).images())
    begin, cpu = time.perf_counter(), time.process_time()
    _check_of_images(kept, images)
    note = f"{time.process_time() - cpu:.1f} s of processors, without decoding"
    yield Row("guard/fixed/two minutes", time.perf_counter() - begin, "s", Bar(high=20), note)
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - sum(image.nbytes for image in images) / 2**20
    yield Row("guard/fixed/memory", used, "MB", Bar(high=1000), "without the clip itself")
