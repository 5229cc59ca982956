"""The badge in Chromium: whenever it says exact, the canvas is what `clsco.render` gives of the values in the boxes."""

from __future__ import annotations

import base64
import json
import random
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.errors import SceneError
from clsco.files.transfer import encode
from tests.studio.browser import SMALL

pytestmark = pytest.mark.browser
FILES, OPENS = {"scene.toml": SMALL}, "scene.toml"
VALUES: dict[str, tuple[Any, ...]] = {
    "camera.focus_distance": (150, 200, 230, 260, 300), "camera.f_number": (1.4, 2, 4, 8),
    "object.0.distance": (180, 220, 250), "object.0.texture": ("checkerboard", "bricks"),
}  # fmt: skip
WRONG = {"camera.focus_distance": (5, "near"), "camera.f_number": (-1,), "object.0.distance": (0,)}
WALK = """async ([path, value, wait, paths]) => {
  const box = (name) => document.querySelector(`:is(#panels, #lens-strip) [data-path="${name}"]:not([type=range])`);
  const control = box(path);
  if (control === null) document.querySelector(`#${path}`).click(); // undo or redo
  else control.value = value;
  for (const kind of ["input", "change"]) control?.dispatchEvent(new Event(kind, { bubbles: true }));
  let isExact = false;
  const found = new Map(), start = performance.now(), canvas = document.querySelector("#canvas");
  do {
    await new Promise(requestAnimationFrame); // what is seen
    const badge = document.querySelector("#badge").textContent;
    isExact = badge === "Exact";
    if (isExact) {
      const boxes = JSON.stringify(paths.map((name) => box(name).value));
      const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
      const key = boxes + data.reduce((sum, code) => (31 * sum + code) % 1000003, 0);
      if (!found.has(key)) found.set(key, [boxes, btoa(String.fromCharCode(...data))]);
    }
  } while (performance.now() - start < wait // the longest goes on until the frame is there
    || (wait > 500 && !isExact && !Object.keys(studio.faults).length && performance.now() - start < 20000));
  return [...found.values()];
}"""


@pytest.mark.parametrize(
    ("steps", "seed"), [pytest.param(12, 1, marks=pytest.mark.everyday), pytest.param(500, 2, marks=pytest.mark.slow)]
)
def test_the_badge_is_right_in_a_walk_of_changes(page: Any, steps: int, seed: int) -> None:
    chooses, paths = random.Random(seed), list(VALUES)
    known: dict[tuple[str, ...], NDArray[np.int64]] = {}
    exact, wrong = 0, ""
    for _ in range(steps):
        path = wrong or chooses.choice([*paths, "undo", "redo"])  # what is wrong is mended in the next step
        wrong = path if path in WRONG and not wrong and chooses.random() < 0.2 else ""
        value = chooses.choice((WRONG if wrong else VALUES).get(path, ("",)))
        for boxes, data in page.evaluate(WALK, [path, str(value), chooses.choice((50, 300, 600)), paths]):
            pixels = np.frombuffer(base64.b64decode(data), np.uint8).reshape(48, 64, 4)[..., :3].astype(int)
            texts = tuple(json.loads(boxes))
            if texts not in known:
                known[texts] = codes(texts)
            assert np.array_equal(pixels, known[texts]), (path, value, texts)
            exact += 1
    assert exact >= steps // 6


def codes(texts: tuple[str, ...]) -> NDArray[np.int64]:
    """Codes of the scene with these values."""
    scene = clsco.parse_scene(SMALL)
    for path, text in zip(VALUES, texts, strict=True):
        try:
            scene = scene.replace(path, text if path.endswith("texture") else float(text))
        except (ValueError, SceneError) as error:
            raise AssertionError(f"exact of what cannot be: {path} = {text}") from error
    found = encode(clsco.render_frame(scene, truth=(), device="pocl").color, 8, "srgb").astype(int)
    return found if found.ndim == 3 else np.repeat(found[..., None], 3, axis=2)
