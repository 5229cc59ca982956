"""docs/studio.png, the studio at a point behind the rim of a ball: python -m benchmarks.studio_picture [-o FILE]

Needs Chromium, and `pip install playwright`.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

from tests.studio.browser import EXAMPLES, chromium, rest
from tests.studio.running import studio

SCENE = "occlusion_three.toml"
ROOT = Path(__file__).parents[1]
POINT = (0.172, 0.42)  # shares of the picture's width and height
WAIT = 60_000  # ms


def main() -> None:
    """Open the scene, rest the pointer on the point until its response is measured, and take the picture."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "studio.png")
    output = parser.parse_args().output
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "scenes"
        root.mkdir()
        shutil.copy(EXAMPLES / SCENE, root)
        with studio(root, str(root / SCENE), "--device", "pocl") as running, chromium() as browser:
            page = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="dark").new_page()
            page.goto(running.address)
            rest(page)
            page.reload()  # the header says what a frame takes; the first one was compiled
            rest(page)
            box = page.locator("#canvas").bounding_box()
            page.mouse.move(box["x"] + POINT[0] * box["width"], box["y"] + POINT[1] * box["height"])
            shown = "/\\d/.test(document.querySelector('#psf-values').rows[0]?.cells[2]?.textContent)"
            offered = "!document.querySelector('#measure').hidden"
            page.wait_for_function(f"{shown} || {offered}", timeout=WAIT)
            if page.evaluate(offered):  # it takes longer than it does unasked
                page.evaluate("document.querySelector('#measure').click()")
            page.wait_for_function(shown, timeout=WAIT)
            rest(page)
            page.screenshot(path=output)
    print(output)


if __name__ == "__main__":
    main()
