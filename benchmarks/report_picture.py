"""Draws docs/report*.png, parts of the page that `make run` writes (`make pictures`); needs Chromium."""

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Literal, NamedTuple

from playwright.sync_api import sync_playwright

from benchmarks.run_picture import run
from calibration.pipeline.results import PAGE_FILE

ROOT = Path(__file__).resolve().parents[1]


class Picture(NamedTuple):
    """Picture of a part of the page."""

    name: str
    part: str
    """CSS selector of where it begins."""
    width: int
    """px."""
    height: int
    """px."""
    scheme: Literal["light", "dark"] = "light"


PICTURES = (
    Picture("report-top.png", "#top", 1100, 700),
    Picture("report.png", "#system-softbot", 1100, 1900),  # to the first residuals
    Picture("report-phone.png", "#system-rlbot .turning", 390, 844, "dark"),
)


def main() -> None:
    """Run the pipeline of calibration.yml, and take the pictures of its page.

    Raises:
        SystemExit: there is no Chromium.
    """
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("needs chromium")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        run(Path(folder))
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for name, part, width, height, scheme in PICTURES:
            page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
            page.goto((Path(folder) / "output" / PAGE_FILE).as_uri())
            page.locator(part).evaluate("part => part.scrollIntoView()")
            if part != PICTURES[0].part:
                page.locator(".turning.opened canvas").first.wait_for()
            page.screenshot(path=ROOT / "docs" / name)
        browser.close()


if __name__ == "__main__":
    main()
