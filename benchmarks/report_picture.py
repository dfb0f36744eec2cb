"""Draws docs/report.png, a part of the page that a run writes here and now (`make pictures`); needs Chromium."""

import json
import shutil
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from calibration.__main__ import main as calibration

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "report.png"
SYSTEM = {"dataset": "softbot", "evaluate": "rgb-to-rgb:front_left_camera:front_right_camera"}
WIDTH, HEIGHT = 1100, 1900
"""Of the picture, px."""


def main() -> None:
    """Run the pipeline on one system, and take a picture of its page.

    Raises:
        SystemExit: there is no Chromium, or the run is red.
    """
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("needs chromium")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "softbot").symlink_to(ROOT / "datasets" / "softbot")
        (Path(folder) / "calibration.yml").write_text(json.dumps({"systems": {"softbot": SYSTEM}}))
        output = Path(folder) / "output"
        if calibration(["run", "--config", f"{folder}/calibration.yml", "--output", str(output)]):
            sys.exit("the run is red")
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            page.goto((output / "report.html").as_uri())
            page.screenshot(path=PICTURE)
            browser.close()


if __name__ == "__main__":
    main()
