"""docs/studio.png, the studio with its first scene: python -m benchmarks.studio_picture [-o FILE]

Needs Chromium, and `pip install playwright`.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

from clsco.studio.presets import FIRST
from tests.studio.browser import EXAMPLES, chromium
from tests.studio.running import studio

ROOT = Path(__file__).parents[1]
POINT = (0.72, 0.586)  # shares of the picture's width and height
WAIT = 120_000  # ms
IS_SMALL = (
    """document.querySelector('[data-view="depth"] canvas').getContext("2d").getImageData(40, 20, 1, 1).data[3]"""
)


def main() -> None:
    """Open the scene, wait for the small views, and take the picture with the pointer on a ball."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "studio.png")
    output = parser.parse_args().output
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "scenes"
        shutil.copytree(EXAMPLES, root)
        view = {"viewport": {"width": 1280, "height": 800}, "color_scheme": "dark"}
        with studio(root, str(root / f"{FIRST}.toml"), "--device", "pocl") as running, chromium(**view) as browser:
            page = browser.new_page()
            page.goto(running.address)
            page.wait_for_function("window.studio && studio.rung === 2", timeout=WAIT)
            page.reload()  # the status says what a frame takes; the first one was compiled
            page.wait_for_function("window.studio && studio.rung === 2", timeout=WAIT)
            page.wait_for_function(IS_SMALL, timeout=WAIT)
            box = page.locator("#canvas").bounding_box()
            page.mouse.move(box["x"] + POINT[0] * box["width"], box["y"] + POINT[1] * box["height"])
            page.locator("#who", has_text="Yellow ball").wait_for(timeout=WAIT)
            page.wait_for_function("document.querySelector('#progress').hidden", timeout=WAIT)
            page.screenshot(path=output)
    print(output)


if __name__ == "__main__":
    main()
