"""Hooks of MkDocs: links out of docs/ lead to the repository, and the site gets an llms.txt."""

import re
from pathlib import Path
from textwrap import shorten
from typing import Any

_LINK_OUT_OF_DOCS = re.compile(r"(!?)(\[[^\]]*\])\(\.\./([^)]+)\)")
_FENCED_BLOCK = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
_SENTENCE = re.compile(r"[A-Z].*?[.?](?=\s|$)")
MAX_SUMMARY_CHARACTERS = 200
"""Limit of a page's summary in llms.txt."""

_summaries: dict[str, str] = {}


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Make links such as ``../calibration.yml`` links to the file in the repository."""
    _summaries[page.file.src_uri] = _first_sentence(markdown)
    return _LINK_OUT_OF_DOCS.sub(
        lambda link: f"{link[1]}{link[2]}({config.repo_url}/{'raw' if link[1] else 'blob'}/main/{link[3]})", markdown
    )


def _first_sentence(markdown: str) -> str:
    for paragraph in _FENCED_BLOCK.sub("", markdown).split("\n\n"):
        if sentence := _SENTENCE.match(" ".join(paragraph.split())):
            return shorten(sentence[0], MAX_SUMMARY_CHARACTERS, placeholder=" …")
    return ""


def on_nav(nav: Any, config: Any, files: Any) -> None:
    """Remember the pages in their order."""
    config.extra["pages"] = [page.file for page in nav.pages]


def on_post_build(config: Any) -> None:
    """Write ``llms.txt`` (llmstxt.org): a line for each page."""
    pages = [
        f"- [{file.page.title}]({file.dest_uri}): {_summaries[file.src_uri]}".rstrip(": ")
        for file in config.extra["pages"]
    ]
    text = "\n".join([f"# {config.site_name}", "", f"> {config.site_description}", "", "## Pages", "", *pages, ""])
    (Path(config.site_dir) / "llms.txt").write_text(text)
