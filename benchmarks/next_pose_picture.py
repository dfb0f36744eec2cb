"""``python -m benchmarks.next_pose_picture``: draw docs/next-pose.svg, from a calibration of a system that ships."""

import re
from dataclasses import replace
from pathlib import Path

from calibration.engine.diagnosis.limits import Limits
from calibration.engine.estimation.options import ALL_EXACT, Options
from calibration.pipeline.matrix.loaded_system import load
from calibration.pipeline.next_poses import advise
from calibration.pipeline.page.label_residuals import poses_in_image
from calibration.pipeline.system import System

ROOT = Path(__file__).parents[1]
SYSTEM, CAMERA, BEGUN = "t2rgb", "left_camera", 4
STYLE = (
    "<style>.pattern{fill:none;stroke:#e8710a;stroke-width:2}.frame{fill:none;stroke:#888}"
    ".label{font:bold 20px sans-serif;fill:#e8710a;paint-order:stroke;stroke:#fff;stroke-width:4px}</style>"
)


def main() -> None:
    """Calibrate the first collections, and draw where the board goes next."""
    options = Options(assume=ALL_EXACT)
    loaded = load(System(SYSTEM, ROOT / "datasets" / SYSTEM, options=options, limits=Limits(translation_mm=0.08)))
    few = replace(loaded, dataset=loaded.dataset.with_collections(range(BEGUN)))
    found = advise(few.prepared.optimum, few, ()).found
    camera = few.dataset.sensors[CAMERA].camera
    if camera is None:
        raise AssertionError(f"{CAMERA} is a camera")
    drawn = poses_in_image(found, CAMERA, (camera.width, camera.height), loaded.dataset)
    text = re.sub("^<svg", '<svg xmlns="http://www.w3.org/2000/svg"', drawn).replace("</title>", f"</title>{STYLE}", 1)
    (ROOT / "docs" / "next-pose.svg").write_text(text + "\n")
    print("\n".join(found.lines))


if __name__ == "__main__":
    main()
