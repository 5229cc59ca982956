"""The studio in Chromium: what is dragged is seen at once, and what rests is exact."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import clsco
from clsco.files.transfer import encode
from tests.studio.browser import DRAG, EXAMPLES, pixels, rest
from tests.studio.running import Running

pytestmark = pytest.mark.browser
SHIPPED, OPENS = ("sphere.toml",), "sphere.toml"


def codes(focus: float) -> NDArray[Any]:
    scene = clsco.load_scene(EXAMPLES / "sphere.toml").replace("camera.focus_distance", focus)
    (frame,) = clsco.render(scene, truth=(), device="pocl")
    return encode(frame.color, 8, "srgb")[..., None]


def test_a_drag_of_the_focus_is_quick_and_ends_exactly(page: Any) -> None:
    page.evaluate(DRAG, ["camera.focus_distance", 250.0, 300.0, 60, 30])  # compiles what it needs
    found = []
    for _ in range(3):  # the machine may do other things
        rest(page)
        found.append(figures(page.evaluate(DRAG, ["camera.focus_distance", 260.0, 300.0, 60, 30])))
        print(f"load {os.getloadavg()[0]:.1f}: {found[-1]}")
    best = min(found, key=lambda one: one["median"])
    assert best["per second"] >= 20
    assert best["median"] <= 60
    assert best["p95"] <= 150
    assert best["exact"] <= 300
    assert np.array_equal(pixels(page), np.broadcast_to(codes(300.0), (512, 512, 3)))


def figures(drag: dict[str, Any]) -> dict[str, float]:
    """Painted frames per second, and times in ms, of a drag."""
    painted = drag["painted"]
    revisions = [revision for revision, _, _ in painted]
    assert revisions == sorted(revisions)  # none that is older than what was shown
    latest = max(revisions)
    assert painted[-1][:2] == [latest, 2]
    delays = []
    for number, time in enumerate(drag["times"]):
        wanted = min(drag["before"] + number + 1, latest)
        delays.append(next(seen for revision, _, seen in painted if revision >= wanted and seen >= time) - time)
    during = [seen for _, _, seen in painted if seen <= drag["released"]]
    return {
        "per second": len(during) / (drag["released"] - drag["times"][0]) * 1000,
        "median": float(np.median(delays)),
        "p95": float(np.percentile(delays, 95)),
        "exact": painted[-1][2] - drag["released"],
    }


def test_memory_is_flat_over_many_steps(page: Any, running: Running) -> None:
    def resident() -> list[float]:
        pids = [running.process.pid, *children(running.process.pid)]
        heap = page.evaluate("() => { globalThis.gc?.(); return performance.memory.usedJSHeapSize / 2 ** 20; }")
        return [heap, *(megabytes(pid) for pid in pids)]

    for _ in range(4):
        page.evaluate(DRAG, ["camera.focus_distance", 250.0, 300.0, 100, 60])
    before = resident()
    for _ in range(20):
        page.evaluate(DRAG, ["camera.focus_distance", 250.0, 300.0, 100, 60])
    after = resident()
    print(f"MiB of page, server, renderer: {before} -> {after}")
    for old, new in zip(before, after, strict=True):
        assert new < old * 1.1 + 30


@pytest.mark.slow
def test_memory_of_the_server_is_flat_over_page_loads(page: Any, running: Running) -> None:
    found = []
    for _ in range(4):
        for _ in range(75):
            page.reload()
            page.wait_for_function("window.studio && studio.revision >= 0")
        rest(page)
        readings = []
        for _ in range(5):  # arrays of a texture that is drawn small come and go
            page.wait_for_timeout(300)
            readings.append(megabytes(running.process.pid))
        found.append(min(readings))
    print(f"MiB of the server after 75, 150, 225 and 300 page loads: {found}")
    assert found[-1] < found[1] * 1.1 + 10  # the first loads fill what is kept


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def megabytes(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
