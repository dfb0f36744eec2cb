"""Draws docs/report.png, the part of a robot on the page that `make run` writes (`make pictures`); needs Chromium."""

import shutil
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from benchmarks.run_picture import run
from calibration.pipeline.results import PAGE_FILE

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "report.png"
PART = "#system-softbot"
WIDTH, HEIGHT = 1100, 1682
"""Width and height of the picture, px: it shows the page from the robot's heading to its first residuals."""


def main() -> None:
    """Run the pipeline of calibration.yml, and take a picture of its page.

    Raises:
        SystemExit: there is no Chromium.
    """
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("needs chromium")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        run(Path(folder))
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        page.goto((Path(folder) / "output" / PAGE_FILE).as_uri())
        page.locator(PART).evaluate("part => part.scrollIntoView()")
        page.screenshot(path=PICTURE)
        browser.close()


if __name__ == "__main__":
    main()
