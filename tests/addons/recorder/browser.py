"""The command in a separate process, and a real browser that opens its page."""

import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from urllib.parse import urlsplit

import numpy as np
from playwright.sync_api import Locator, Page, expect, sync_playwright

from calibration.addons.recorder.page import FIELD_OF_VIEW
from calibration.base.arrays import Array
from tests.chromium import CHROMIUM

SOFTWARE_GRAPHICS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
PATIENCE = 60_000  # ms: a test that waits so long has failed
SIZE = {"width": 1300, "height": 800}


class Recorder:
    """``calibration record-motion`` as a process."""

    def __init__(self, arguments: list[str], folder: Path) -> None:
        self.lines: list[str] = []
        self._process = subprocess.Popen(
            [sys.executable, "-m", "calibration", "record-motion", "--port", "0", *arguments],
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        self._reader = Thread(target=self._read)  # so that a full pipe never stops it
        self.url = self._address()
        self._reader.start()

    def _address(self) -> str:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.lines.append(line)
            if found := re.search(r"http://127\.0\.0\.1:\d+/\S+/", line):
                return found[0]
        self._process.wait(60)
        raise AssertionError("".join(self.lines))

    def _read(self) -> None:
        assert self._process.stdout is not None
        self.lines += self._process.stdout

    def stop(self, number: signal.Signals) -> int:
        """Send a signal; the exit code."""
        self._process.send_signal(number)
        code = self._process.wait(60)
        self._reader.join(60)
        return code

    @property
    def output(self) -> str:
        return "".join(self.lines)

    def close(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait(60)
        self._reader.join(60)
        assert self._process.stdout is not None
        self._process.stdout.close()


@contextmanager
def recorder(folder: Path, *arguments: str) -> Iterator[Recorder]:
    """The recorder, which is gone afterwards whatever happens."""
    running = Recorder(list(arguments), folder)
    try:
        yield running
    finally:
        running.close()


class View:
    """A user's actions on the page, by the labels of the page."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.requests: list[str] = []
        page.context.on("request", lambda request: self.requests.append(request.url))
        page.on("websocket", lambda socket: self.requests.append(socket.url))

    def open(self, url: str) -> None:
        self.page.goto(url)
        self.settled()

    def settled(self) -> str:
        """Wait until the verdict is that of the current pose, and return its text."""
        verdict = self.page.locator("#verdict")
        expect(verdict).to_have_attribute("aria-busy", "false", timeout=PATIENCE)
        return verdict.inner_text()

    def button(self, name: str) -> Locator:
        return self.page.get_by_role("button", name=name, exact=True)

    def click(self, name: str) -> None:
        expect(self.button(name)).to_be_enabled(timeout=PATIENCE)
        self.button(name).click()

    def has_poses(self, words: str | re.Pattern[str]) -> None:
        expect(self.page.locator("#count")).to_have_text(words, timeout=PATIENCE)

    def says(self, words: str | re.Pattern[str]) -> None:
        expect(self.page.locator("#message")).to_have_text(words, timeout=PATIENCE)

    def drag_in_scene(self, start: Array, end: Array, position: Array, look_at: Array) -> None:
        """Drag with the mouse from one point (3,) of the world to another, in the view that the page begins with.

        On a busy machine the page may notice the mouse too late, and turns the view in place of the handle: then again.
        """
        before = self._numbers()
        for patience in (500, 1500, 4000):  # ms
            self._drag(start, end, position, look_at, patience)
            for _ in range(20):
                self.page.wait_for_timeout(patience / 10)
                numbers = self._numbers()
                self.page.wait_for_timeout(patience / 2)
                if numbers != before and numbers == self._numbers():
                    self.settled()
                    return
            self.page.reload()
            self.settled()
        raise AssertionError("the handle does not follow the mouse")

    def _numbers(self) -> list[str]:
        """Return the current pose, as its inputs show it."""
        return [box.input_value() for box in self.page.get_by_role("textbox").all()]

    def _drag(self, start: Array, end: Array, position: Array, look_at: Array, patience: float) -> None:
        canvas = self.page.locator("canvas").first.bounding_box()
        assert canvas is not None
        a, b = (_on_screen(point, position, look_at, canvas) for point in (start, end))
        mouse = self.page.mouse
        mouse.move(*(a - 3))
        mouse.move(*a)
        self.page.wait_for_timeout(patience)  # the handle has to notice the mouse
        mouse.down()
        for share in np.linspace(0, 1, 9)[1:]:
            mouse.move(*(a + share * (b - a)))
            self.page.wait_for_timeout(50)
        mouse.up()

    @property
    def foreign_requests(self) -> list[str]:
        """Return the requests to other hosts than the recorder."""
        local = ("blob", "data", "about")
        return [
            url
            for url in self.requests
            if urlsplit(url).scheme not in local and urlsplit(url).hostname not in ("127.0.0.1", "localhost")
        ]


@contextmanager
def browser() -> Iterator[View]:
    """A page in a headless Chromium."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=list(SOFTWARE_GRAPHICS))
        try:
            page = chromium.new_context(viewport=SIZE, accept_downloads=True).new_page()  # type: ignore[arg-type]
            page.set_default_timeout(PATIENCE)
            yield View(page)
        finally:
            chromium.close()


def _on_screen(point: Array, position: Array, look_at: Array, canvas: object) -> Array:
    """The pixel (2,) of a point (3,) in the world, z up."""
    assert isinstance(canvas, dict)
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    ray = point - position
    scale = canvas["height"] / 2 / math.tan(FIELD_OF_VIEW / 2) / (ray @ forward)
    middle = np.array([canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2])
    pixel: Array = middle + scale * np.array([ray @ right, -(ray @ up)])
    return pixel
