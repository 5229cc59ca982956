"""Renders that differ in little, one after the other, in an old version and in this one, by turns: processor time.

Run it with this version's Python; scenes come from a folder that both can read:
    .venv/bin/python benchmarks/speed/live.py --old OLD/.venv/bin/python --examples OLD/examples
Each drag is 15 values of one key; the old version renders each by `clsco.render`, this one by `clsco.Live` (--plain: by
`clsco.render` as well). It prints medians in ms, and of the ratio old / new, value by value; "passes" is the time that
the passes of this version's renders take alone, enqueued again on buffers that are there.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

FOCUS = [240.0 + 5.0 * k for k in range(15)]
# Name -> example, pixels a side, key, values.
DRAGS: dict[str, tuple[str, int, str, list[Any]]] = {
    "focus, sphere": ("sphere", 512, "camera.focus_distance", FOCUS),
    "focus, sphere, 256 px": ("sphere", 256, "camera.focus_distance", FOCUS),
    "focus, three objects": ("occlusion_three", 512, "camera.focus_distance", FOCUS),
    "moved, sphere": ("sphere", 512, "object[0].center", [[0.0, 0.1 * k, 280.0] for k in range(15)]),
    "moved, three objects": ("occlusion_three", 512, "object[0].center", []),
}


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--old", type=Path, help="Python of the old version; without it this one alone")
    parser.add_argument("--new", type=Path, default=Path(sys.executable), help="Python of the new version")
    parser.add_argument("--examples", type=Path, help="folder of scene files")
    parser.add_argument("--only", default="", help="part of the names of the drags")
    parser.add_argument("--plain", action="store_true", help="by clsco.render in both")
    parser.add_argument("--worker", choices=("old", "new", "plain"), help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.worker:
        serve(chosen.worker)
        return
    print(f"{'ms of processor time':26}{'old':>9}{'new':>9}{'old/new':>9}{'passes':>9}{'share':>8}")
    for name, drag in DRAGS.items():
        if chosen.only in name:
            row(name, measured(chosen, drag))


def row(name: str, found: list[dict[str, Any]]) -> None:
    """Print medians of a drag; found: per value "old", "new" and "passes" in s."""
    old, new, passes = (median(each[key] for each in found) for key in ("old", "new", "passes"))
    ratio = median(each["old"] / each["new"] for each in found)
    share = median(each["passes"] / each["new"] for each in found)
    print(f"{name:26}{1e3 * old:9.1f}{1e3 * new:9.1f}{ratio:9.2f}{1e3 * passes:9.1f}{100 * share:7.0f}%", flush=True)


def measured(chosen: argparse.Namespace, drag: tuple[str, int, str, list[Any]]) -> list[dict[str, Any]]:
    """Processor time in s of each value of a drag in both versions by turns; the first three do not count."""
    kinds = {"new": chosen.new} if chosen.old is None else {"old": chosen.old, "new": chosen.new}
    workers = {
        kind: subprocess.Popen(
            (str(python), str(Path(__file__).resolve()), "--worker", "plain" if chosen.plain else kind),
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        for kind, python in kinds.items()
    }  # fmt: skip
    example, size, key, values = drag
    path = str(chosen.examples / f"{example}.toml")
    found = []
    for number in [0, 1, 2, *range(len(values) or 15)]:
        answers = {kind: ask(worker, [path, size, key, values, number]) for kind, worker in workers.items()}
        new = answers["new"]
        found.append({"new": new["all"], "passes": new["passes"], "old": answers.get("old", new)["all"]})
    for worker in workers.values():
        worker.communicate()
    return found[3:]


def ask(worker: subprocess.Popen[str], what: list[Any]) -> dict[str, float]:
    """Have a worker render one value of a drag."""
    assert worker.stdin is not None
    assert worker.stdout is not None
    worker.stdin.write(json.dumps(what) + "\n")
    worker.stdin.flush()
    answer: dict[str, float] = json.loads(worker.stdout.readline())
    return answer


def serve(kind: str) -> None:
    """Render what lines of standard input name."""
    import clsco

    render = clsco.Live().render if kind == "new" else lambda scene, truth: next(iter(clsco.render(scene, truth=truth)))
    latest = noted() if kind == "new" else []
    for line in sys.stdin:
        path, size, key, values, number = json.loads(line)
        scene = changed(clsco, Path(path), size, key, values, number)
        before = time.process_time()
        frame = render(scene, truth=())
        spent = time.process_time() - before
        passes = passes_of(latest[0], "cast" in frame.metadata["seconds"]) if latest else 0.0
        print(json.dumps({"all": spent, "passes": passes}), flush=True)


def noted() -> list[Any]:
    """Keeps the renderer of the last frame in a list."""
    from clsco.engine.renderer import Renderer

    latest: list[Any] = []
    finish = Renderer.finish

    def noting(self: Any, *frame: Any) -> Any:
        latest[:] = [self]
        return finish(self, *frame)

    Renderer.finish = noting  # type: ignore[assignment, method-assign]
    return latest


def passes_of(renderer: Any, casts: bool) -> float:
    """Processor time in s of the passes of a frame, run once more by themselves; casts: rays as well."""
    from clsco.engine.renderer import expose

    if casts:
        session = renderer.scene.session
        (session.cache if hasattr(session, "cache") else session.kept).clear()  # as older versions call it
    before = time.process_time()
    expose([renderer], 0)
    renderer.scene.session.queue.finish()
    return time.process_time() - before


def changed(clsco: Any, path: Path, size: int, key: str, values: list[Any], number: int) -> Any:
    """The scene of a drag; an object without values moves to the right by a tenth of a mm each time."""
    base = clsco.load_scene(path)
    pitch = base.camera.pixel_pitch * base.camera.resolution[0] / size if base.camera.resolution else 5.12 / size
    places = [f"camera.resolution=[{size}, {size}]", f"camera.pixel_pitch={pitch!r}"]
    if values:
        value = values[number % len(values)]
    else:
        item = base.objects[0]
        key = f"object[0].{'center' if hasattr(item, 'center') else 'distance'}"
        place = getattr(item, key.split(".")[1])
        value = [place[0] + 0.1 * number, *place[1:]] if isinstance(place, tuple) else place + 0.1 * number
    return clsco.load_scene(path, [*places, f"{key}={json.dumps(value)}"])


if __name__ == "__main__":
    main()
