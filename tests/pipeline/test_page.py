"""``report.html`` of real runs, read in a browser: everything drawn, nothing loaded, usable without eyes or scripts."""

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from calibration.__main__ import main
from calibration.pipeline.page import run_page
from calibration.pipeline.page.label_residuals import MAX_VIEWS
from tests.chromium import CHROMIUM

pytest.importorskip("playwright")
pytest.importorskip("axe_playwright_python")
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, sync_playwright

ROOT = Path(__file__).parents[2]
CONFIGURATION = {
    "systems": {
        "cameras": {"dataset": "t2rgb", "evaluate": "rgb-to-rgb:left_camera:right_camera"},
        "lidar": {"dataset": "rlbot", "truth": "none", "limits": {"translation-mm": 0.1}},
        "red": {"dataset": "riwbot", "limits": {"translation-mm": 0.0001}},
    }
}
SLOW_GRAPHICS = "GPU stall due to ReadPixels"
"""What a browser without a graphics processor says about every 3D view."""
RULES = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice")


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a run of three systems: one that passes, an undecided and a red one."""
    folder = tmp_path_factory.mktemp("run")
    for name in ("t2rgb", "rlbot", "riwbot"):
        without = ("*.png",) if name == "t2rgb" else ("*.jpg", "*.png")
        shutil.copytree(ROOT / "datasets" / name, folder / name, ignore=shutil.ignore_patterns(*without))
    (folder / "calibration.yml").write_text(json.dumps(CONFIGURATION))
    output = folder / "output"
    assert main(["run", "--config", str(folder / "calibration.yml"), "--output", str(output), "--jobs", "1"]) == 1
    return output / "report.html"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("needs chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


def _open_scenes(page: Page, count: int) -> None:
    """Bring scenes into view, as three.js is unpacked for the first that a reader sees."""
    for number in range(count):
        page.locator(".turning").nth(number).scroll_into_view_if_needed()
        page.locator(".turning.opened").nth(number).wait_for()


@pytest.mark.thorough(but_first=1)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_opens_offline_without_an_error_and_axe_finds_nothing(report: Path, chromium: Browser, scheme: Any) -> None:
    context = chromium.new_context(color_scheme=scheme, offline=True)
    page = context.new_page()
    said: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(report.as_uri())
    _open_scenes(page, 3)
    assert [each for each in said if SLOW_GRAPHICS not in each] == []
    assert page.locator("h1").inner_text() == "Calibration of 3 robots"
    assert page.locator("h2").all_inner_texts() == list(CONFIGURATION["systems"])
    assert page.locator("canvas").count() == 3
    assert page.locator("image").count() == MAX_VIEWS  # of the system whose images are there
    drawn = page.evaluate(
        "[...document.querySelectorAll('canvas')].map(c => new Set(c.getContext('2d').getImageData(0, 0, c.width,"
        " c.height).data).size)"
    )
    assert min(drawn) > 3  # more than one colour: not empty
    found = Axe().run(page, options={"runOnly": {"type": "tag", "values": list(RULES)}})
    assert found.violations_count == 0, found.generate_report()
    context.close()


def test_tables_are_sorted_and_the_scene_is_turned_by_keys(report: Path, chromium: Browser) -> None:
    page = chromium.new_page()
    page.goto(report.as_uri())
    header = page.get_by_role("columnheader", name="x, y, z (mm)").first
    header.get_by_role("button").focus()
    page.keyboard.press("Enter")
    assert header.get_attribute("aria-sort") == "ascending"
    _open_scenes(page, 1)
    canvas = page.locator("canvas").first
    before = canvas.evaluate("c => c.toDataURL()")
    canvas.focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("+")
    turned = canvas.evaluate("c => c.toDataURL()")
    assert turned != before
    page.get_by_role("slider").first.press("ArrowRight")
    assert page.get_by_role("status").first.inner_text() == "collection 000"
    scrubbed = canvas.evaluate("c => c.toDataURL()")
    assert scrubbed != turned
    page.get_by_label("cameras", exact=True).first.uncheck()
    assert canvas.evaluate("c => c.toDataURL()") != scrubbed
    page.get_by_role("button", name="Top").first.click()
    page.close()


def test_it_reads_without_scripts(report: Path, chromium: Browser) -> None:
    context = chromium.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(report.as_uri())
    for text in ("How sure", "Residuals", "expected at most 0.0001 mm"):
        assert page.get_by_text(text).first.is_visible(), text
    assert page.locator(".turning svg").first.is_visible()
    context.close()


def test_the_same_results_make_the_same_bytes(report: Path, tmp_path: Path) -> None:
    folder = report.parents[1]
    again = tmp_path / "output"
    assert main(["run", "--config", str(folder / "calibration.yml"), "--output", str(again), "--jobs", "2"]) == 1
    assert (again / "report.html").read_bytes() == report.read_bytes()


def test_a_page_has_every_table_and_each_reason_once_whatever_its_colour(report: Path) -> None:
    text = report.read_text()
    sections = {name: text.split(f'id="system-{name}"')[1].split("</section>")[0] for name in CONFIGURATION["systems"]}
    for (name, part), verdict in zip(sections.items(), ("pass", "undecided", "fail"), strict=True):
        assert f'class="verdict {verdict}"' in part, name
        for column in ("Calibrated", "x, y, z (mm)", "What the result hangs on"):
            assert f">{column}</th>" in part
        assert "In space" in part
        assert "Residuals" in part
    for name, reason in (("lidar", "is not determined well enough"), ("red", "error against the truth")):
        assert sections[name].count(reason) == text.count(reason) > 0
    collections = json.loads((ROOT / "datasets" / "riwbot" / "dataset.json").read_text())["collections"]
    assert re.search(rf"<td>charuco[^<]*</td><td>{len(collections)}</td><td>rgb_world</td>", text)


def test_its_head_says_what_passes_how_sure_it_is_and_what_changed(report: Path, chromium: Browser) -> None:
    page = chromium.new_page()
    page.goto(report.as_uri())
    assert "red fails; lidar is undecided." in page.locator(".banner.fail").inner_text()
    rows = [row.split("\t") for row in page.locator("table").first.inner_text().splitlines()]
    assert rows[0][:3] == ["Robot", "Verdict", "Error bars"]
    assert [row[:2] for row in rows[1:]] == [["cameras", "pass"], ["lidar", "UNDECIDED"], ["red", "FAIL"]]
    assert all(re.match(r"\w+\s±\s[\d.]+\smm,\s[\d.]+\sdeg", row[2]) for row in rows[1:])  # worst sensor first
    colours = [
        page.locator(f"table td.{verdict}").first.evaluate("cell => getComputedStyle(cell).color")
        for verdict in ("undecided", "fail")
    ]
    assert colours == ["rgb(154, 103, 0)", "rgb(207, 34, 46)"]
    page.get_by_role("link", name="lidar").click()
    assert page.url.endswith("#system-lidar")
    page.get_by_text("The matrix: 1 start").click()
    cell = page.locator("details[open] td span").first
    assert cell.inner_text().count("px") == 1
    assert "mm" in str(cell.get_attribute("title"))
    page.close()


def test_it_is_small(report: Path) -> None:
    assert report.stat().st_size < 1_000_000


@pytest.mark.thorough
def test_a_dataset_that_is_collected_shows_all_its_images(small: Path, tmp_path: Path, chromium: Browser) -> None:
    options = ["--motion", "generate:3", "--output", str(tmp_path / "out"), "--jobs", "1"]
    assert main(["collect-data-sim", "--system", str(small), *options]) in (0, 1)
    page = chromium.new_page()
    page.goto((tmp_path / "out" / "report.html").as_uri())
    width = page.get_by_alt_text("Contact sheet").evaluate("image => image.naturalWidth")
    assert width > 500
    assert Axe().run(page, options={"runOnly": {"type": "tag", "values": list(RULES)}}).violations_count == 0
    page.close()


@pytest.mark.thorough
def test_of_more_systems_than_the_page_takes_those_that_failed_are_drawn(
    report: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_page, "MAX_SECTION_CHARACTERS", 1000)
    folder = report.parents[1]
    assert main(["run", "--config", str(folder / "calibration.yml"), "--output", str(tmp_path), "--jobs", "1"]) == 1
    text = (tmp_path / "report.html").read_text()
    assert [name for name in CONFIGURATION["systems"] if f'id="system-{name}"' in text] == ["red"]
    assert "2 of 3 systems are in the tables only" in text
