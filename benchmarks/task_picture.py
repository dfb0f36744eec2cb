"""Draws docs/tasks.png, maps of the error of two tasks on the page of a run (`make pictures`); needs Chromium."""

import shutil
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from calibration.__main__ import main as calibration
from calibration.pipeline.results import PAGE_FILE

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "tasks.png"
CONFIGURATION = f"""
systems:
  spjbot:
    dataset: {ROOT}/datasets/spjbot
    truth: none
    undecided: pass
    tasks:
      grasp: {{seen-by: rgb_hand, in: end_effector_link, distance: 0.6, limit-mm: 4}}
      tip: {{of: end_effector_link, in: base_link, points: [[0, 0, 0.1]], limit-mm: 0.5}}
"""


def main() -> None:
    """Run a system with tasks, and take a picture of their maps.

    Raises:
        SystemExit: there is no Chromium.
    """
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("needs chromium")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        path, output = Path(folder) / "calibration.yml", Path(folder) / "output"
        path.write_text(CONFIGURATION)
        calibration(["run", "--config", str(path), "--output", str(output)])
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1000, "height": 800})
        page.goto((output / PAGE_FILE).as_uri())
        page.locator("h3:has-text('where it works') + .figures").screenshot(path=PICTURE)
        browser.close()


if __name__ == "__main__":
    main()
