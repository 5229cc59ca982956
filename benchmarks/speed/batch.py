"""Data sets by `clsco dataset make` against loops: samples per second, in turns.

Run it with this version's Python; the old version renders the same scenes, from a file that both read:
    .venv/bin/python benchmarks/speed/batch.py --old OLD/.venv/bin/python
A sample is a sphere at a random place with a random focus and f-number, 256 x 256, with color, sharp, depth and coc.
"old loop": `clsco.render` of the old version in one process, one scene after the other; nothing is encoded or written.
"Live loop": `clsco.Live` of this version in one process, with all that batch does to a sample: it is encoded, hashed,
measured, written to tar files, and these are hashed and on the disk. "batch": the command with its default of
processes, from its start to its end. "steady": the same by its log, from the first shard to the last one, without the
start. Scenes of the loops are drawn and parsed beforehand; batch draws and parses its own. Each round has another seed.
It prints medians of rounds of samples per second, and of processor time per sample, which others on the machine disturb
less; ratios of both round by round; what a sample costs batch in each phase; and the memory of a process.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from clsco.resources import processors

DISTRIBUTION = """
[camera]
resolution = [256, 256]
pixel_pitch = 0.02
[vary.camera]
focus_distance = { uniform = [220, 320] }
f_number = { choice = [1.4, 2, 2.8, 4], weights = [1, 2, 2, 1] }
[[vary.object]]
shape = "sphere"
center = { frustum = { depth = [260, 340], margin = 20 } }
radius = 30.0
"""
ARRAYS = ("color", "sharp", "depth", "coc")
WARM = 8  # scenes that a loop renders before its time begins


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--old", type=Path, help="Python of the old version; without it this one's clsco.render")
    parser.add_argument("--count", type=int, default=500, help="samples of a round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--workers", default="", help="processes of batch, by default as many as it takes")
    parser.add_argument("--loop", choices=("old", "live"), help=argparse.SUPPRESS)
    parser.add_argument("--scenes", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.loop:
        print(json.dumps(looped(chosen.loop, chosen.scenes)))
        return
    with tempfile.TemporaryDirectory(prefix="clsco-batch-speed-") as name:
        report([measured(chosen, Path(name), seed) for seed in range(chosen.rounds)])


def report(rounds: list[dict[str, Any]]) -> None:
    """Print medians, and ratios round by round."""
    for name in ("old loop", "Live loop", "batch", "steady"):
        spent = [1e3 * each["spent"][name] for each in rounds if name in each["spent"]]
        time_of = f", {median(spent):.1f} ms of processor time" if spent else ""
        print(f"{name:10}{median(each[name] for each in rounds):8.1f} samples/s{time_of}")
    for name in ("old loop", "Live loop"):
        ratios = [each["batch"] / each[name] for each in rounds]
        steady = median(each["steady"] / each[name] for each in rounds)
        cores = processors()
        ideal = median(cores * each["spent"][name] / each["spent"]["batch"] for each in rounds)
        spread = f"{min(ratios):.2f} to {max(ratios):.2f}"
        print(f"batch / {name}: {median(ratios):.2f} ({spread}), steady {steady:.2f}; by processor time {ideal:.2f}")
    for name in rounds[0]["phases"]:
        print(f"{name:10}{median(each['phases'][name] for each in rounds):8.2f} ms per sample")
    print("memory of a process at 25, 50, 75, 100 %, MiB:", *rounds[-1]["rss"])


def measured(chosen: argparse.Namespace, base: Path, seed: int) -> dict[str, Any]:
    """One round: samples per second of each way."""
    (base / "set.toml").write_text(DISTRIBUTION)
    scenes, out = base / "scenes.json", base / "set"
    scenes.write_text(json.dumps(tables(base / "set.toml", seed, chosen.count)))
    found: dict[str, Any] = {"spent": {}}
    for name, python, loop in (
        ("old loop", chosen.old or sys.executable, "old"),
        ("Live loop", sys.executable, "live"),
    ):
        words = [str(python), str(Path(__file__).resolve()), "--loop", loop, "--scenes", str(scenes)]
        answer = subprocess.run(words, check=True, capture_output=True, text=True).stdout
        found[name], found["spent"][name] = json.loads(answer)
    words = [
        "dataset",
        "make",
        str(base / "set.toml"),
        "-o",
        str(out),
        "--count",
        str(chosen.count),
        "--seed",
        str(seed),
    ]
    words += ["--shard-size", "50", *(["--workers", chosen.workers] if chosen.workers else [])]
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([str(Path(sys.executable).parent / "clsco"), *words], check=True, stdout=subprocess.DEVNULL)
    found["batch"], after = chosen.count / (time.perf_counter() - start), resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    found["spent"]["batch"] = spent / chosen.count
    logs = sorted((json.loads(path.read_text()) for path in (out / "log").iterdir()), key=lambda log: log["ended"])
    found["steady"] = chosen.count / (max(log["ended"] for log in logs) - min(log["began"] for log in logs))
    phases = {name: 1e3 * sum(log["seconds"][name] for log in logs) / chosen.count for name in logs[0]["seconds"]}
    found["phases"] = phases
    found["rss"] = [logs[max(0, len(logs) * quarter // 4 - 1)]["rss"] >> 20 for quarter in range(1, 5)]
    shutil.rmtree(out)
    return found


def tables(path: Path, seed: int, count: int) -> list[dict[str, Any]]:
    """Scenes of the samples of a seed."""
    from clsco.data.distribution import load_distribution

    distribution = load_distribution(path)
    return [distribution.draw(seed, number).table for number in range(count)]


def looped(loop: str, path: Path) -> tuple[float, float]:
    """Samples per second, and processor time in s of a sample, of a loop over scenes in this process."""
    import clsco

    scenes = [clsco.parse_scene(table) for table in json.loads(path.read_text())]
    return old_loop(clsco, scenes) if loop == "old" else live_loop(path, scenes)


def old_loop(clsco: Any, scenes: list[Any]) -> tuple[float, float]:
    """By `clsco.render`, of any version; nothing is done with the frames."""
    first = next(iter(clsco.render(scenes[0])))
    truth = ("sharp", "depth", "blur_radius" if hasattr(first, "blur_radius") else "coc")
    for scene in scenes[:WARM]:
        next(iter(clsco.render(scene, truth=truth)))
    start, spent = time.perf_counter(), time.process_time()
    for scene in scenes:
        next(iter(clsco.render(scene, truth=truth)))
    return len(scenes) / (time.perf_counter() - start), (time.process_time() - spent) / len(scenes)


def live_loop(path: Path, scenes: list[Any]) -> tuple[float, float]:
    """By `clsco.Live`, with records, hashes and files as batch makes them."""
    import clsco
    from clsco.data.containers import container_named
    from clsco.data.distribution import Sample
    from clsco.data.record import make_record
    from clsco.data.shards import statistics
    from clsco.files.atomic import sha256

    given, container = json.loads(path.read_text()), container_named("webdataset")
    with clsco.Live() as live, tempfile.TemporaryDirectory() as folder:

        def records(first: int, end: int) -> Any:
            for number in range(first, end):
                frame = live.render(scenes[number], truth=("sharp", "depth", "blur_radius"))
                sample = Sample(number, "", 1, {}, given[number], ("",), (scenes[number],))
                record = make_record(sample, 0, [[frame]], ARRAYS)
                record.sha256()
                statistics(record.arrays)
                yield record

        list(records(0, WARM))
        start, spent = time.perf_counter(), time.process_time()
        for first in range(0, len(scenes), 50):
            shard = Path(folder) / f"{first:06d}.tar"
            container.write(shard, records(first, min(first + 50, len(scenes))))
            sha256(shard)
            with open(shard, "rb") as file:
                os.fsync(file.fileno())
        return len(scenes) / (time.perf_counter() - start), (time.process_time() - spent) / len(scenes)


if __name__ == "__main__":
    main()
