"""The documentation as a site: built from docs/ without a network, strictly, and asking nobody for anything."""

import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest

from calibration.commands.init import DEFAULT_SUITE

from .yaml_lines import PROJECT

REQUESTED = {"img": "src", "script": "src", "iframe": "src", "link": "href"}
"""What a browser asks for by itself, by tag; `link` also says what the page is about."""
REPOSITORY = f"https://github.com/{DEFAULT_SUITE.partition('@')[0]}"
PAGES = {page.name for page in (PROJECT / "docs").glob("*.md")}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", folder],
        cwd=PROJECT,
        env={"NO_MKDOCS_2_WARNING": "1", "PATH": "", "http_proxy": "http://127.0.0.1:9"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    return folder


def requests(page: Path) -> Iterator[str]:
    """The addresses that a browser asks for when it shows a page."""
    found: list[str] = []

    class Requests(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            values = dict(attrs)
            if tag in REQUESTED and values.get("rel") not in ("canonical", "next", "prev", "edit"):
                found.append(values.get(REQUESTED[tag]) or "")

    Requests().feed(page.read_text())
    yield from found


def test_every_page_is_there_and_found(site: Path) -> None:
    shown = {page.stem for page in site.glob("*.html")} - {"404"}
    assert shown == {Path(page).stem for page in PAGES} - {"README"} | {"index"}
    listed = re.findall(r"^- \[[^\]]+\]\(([^)]+)\)", (site / "llms.txt").read_text(), re.MULTILINE)
    assert {Path(page).stem for page in listed} == shown
    assert "guard band" in (site / "search" / "search_index.json").read_text()


def test_a_page_asks_no_other_server_but_for_pictures_of_the_repository(site: Path) -> None:
    elsewhere = {address for page in site.glob("*.html") for address in requests(page) if ":" in address}
    assert {address for address in elsewhere if not address.startswith(("data:", f"{REPOSITORY}/"))} == set()


def test_links_out_of_the_pages_lead_to_files_of_the_repository(site: Path) -> None:
    links = re.findall(
        rf'"{REPOSITORY}/(?:blob|raw)/main/([^"#]+)',
        "".join(page.read_text() for page in site.glob("*.html")),
    )
    assert "calibration/pipeline/results.schema.json" in links
    assert [link for link in links if not (PROJECT / link).exists()] == []
