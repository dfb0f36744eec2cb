"""Draws docs/run.svg, the picture of the README: what `calibration run` prints here and now (`make pictures`)."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from html import escape
from pathlib import Path

from calibration.engine.baseline.quality import BASELINE_FILE

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "run.svg"

SIZE, ADVANCE, LINE, MARGIN = 15, 9, 22, 20
"""Pixels: the height of the font, the width of a character, from line to line, around all."""
CLASSES = (
    ("head", r"\$ |Start |Against |How sure |Calibrated |What the result |Camera |Collected |Notes"),
    ("pass", "pass:"),
    ("fail", "fail:|.* FAIL"),
)
"""How a line is drawn that begins so."""
DRAWING = f"""\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {{width}} {{height}}" role="img">
<title>{{title}}</title>
<style>
text {{{{ font: {SIZE}px ui-monospace, Menlo, Consolas, "DejaVu Sans Mono", monospace; fill: #d6dce4; }}}}
.head {{{{ font-weight: bold; fill: #79c0ff; }}}}
.pass {{{{ font-weight: bold; fill: #56d364; }}}}
.fail {{{{ font-weight: bold; fill: #f87169; }}}}
</style>
<rect width="{{width}}" height="{{height}}" rx="8" fill="#161b22"/>
{{lines}}
</svg>
"""
"""With fonts of the reader's machine, since a picture in a README may load none, and with a background of its own."""


def main() -> None:
    """Run the pipeline of calibration.yml, and draw its tables and its verdict."""
    with tempfile.TemporaryDirectory() as folder:
        PICTURE.write_text(drawing("$ calibration run\n" + tables(run(Path(folder)))))


def run(folder: Path) -> str:
    """Output of the command, run in an empty folder with the configuration and the datasets of this project.

    Raises:
        subprocess.CalledProcessError: the verdict is not pass.
    """
    for name in ("calibration.yml", "datasets"):
        (folder / name).symlink_to(ROOT / name)
    shutil.copy(ROOT / BASELINE_FILE, folder)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GITHUB_")}
    done = subprocess.run(
        [sys.executable, "-m", "calibration", "run"],
        cwd=folder,
        env={**environment, "PYTHONPATH": str(ROOT)},
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return done.stdout


def tables(printed: str) -> str:
    """Part of the output below the lines of progress."""
    return re.sub(r"^\[ *\d+/\d+\] .*\n", "", printed, flags=re.MULTILINE).strip()


def drawing(text: str) -> str:
    """Draw lines of text as a terminal shows them; headers and verdict stand out."""
    lines = text.splitlines()
    return DRAWING.format(
        title=escape(f"{lines[0].removeprefix('$ ')}: {lines[-1]}"),
        width=max(map(len, lines)) * ADVANCE + 2 * MARGIN,
        height=len(lines) * LINE + 2 * MARGIN,
        lines="\n".join(_line(line, MARGIN + LINE * number + SIZE) for number, line in enumerate(lines) if line),
    )


def _line(text: str, y: int) -> str:
    style = next((f' class="{name}"' for name, begin in CLASSES if re.match(begin, text)), "")
    # Its length is given, so that columns stand in line in any font.
    place = f'x="{MARGIN}" y="{y}" textLength="{len(text) * ADVANCE}"'
    return f'<text {place}{style} xml:space="preserve">{escape(text)}</text>'


if __name__ == "__main__":
    main()
