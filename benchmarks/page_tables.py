"""Tables of pages from files of benchmarks/results: python -m benchmarks.page_tables

Each stands in its page between `<!-- table: NAME -->` and `<!-- table: end -->`; tests/benchmarks/test_page_tables.py
compares them.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RESULTS, DOCS = ROOT / "benchmarks/results", ROOT / "docs"
END = "<!-- table: end -->\n"
SCATTER_ERROR = "below 1.2e-3"  # of photographic scenes whose error the noise of the path tracer hides

Row = dict[str, str]

SCENES = {
    "portrait": "card, tube, ball, photo, R to 24 px", "street": "street of 12 cards, R to 15 px",
    "fence": "20 wires before a face, R to 16 px", "macro": "tilted plane, 3 balls, R to 60 px",
    "cart": "rolling cart, photo, R to 20 px",
}  # fmt: skip
MEMORY = {
    "`clsco.render`": "render", "`clsco.defocus`": "defocus", "`clsco.defocus`, layered occlusion": "layered",
    "`clsco defocus` of files": "map",
}  # fmt: skip
STILL_SETTINGS = {
    "thesis": "the thesis' (sampled PSF)", "edge area": '`psf.edge = "area"`',
    "integrated, no tilt, no silhouettes": "no tilt, no silhouettes", "no tilt": "no tilt",
    "no silhouettes": "no silhouettes", "defaults": "defaults",
}  # fmt: skip
STILL_SCENES = {
    "sphere": ("sphere",), "cylinder": ("cylinder",), "ellipsoid": ("ellipsoid",), "cone": ("cone",),
    "plane tilted in x, in both": ("plane_b1.5", "plane_b1_c1"),
}  # fmt: skip
MOVING_SETTINGS = {
    "thesis": "the thesis' (forward warp, 5 endpoints)", "5 samples": "5 time samples", "forward": "forward warp",
    "bilinear": '`motion.texture_filter = "bilinear"`', "defaults": "defaults",
}  # fmt: skip
MOVING_SCENES = {
    "plane moving 17 px, in focus": ("plane_moving_250",), "plane moving 17 px, defocused": ("plane_moving_240",),
    "sphere turning": ("sphere_turning",), "sphere turning and moving": ("sphere_moving_turning",),
}  # fmt: skip
DEVIATION_CAUSES = {
    "the scene asks for approximations": ("thesis_pipeline",),
    "a projected texture is seen anew": (
        "background", "bowl", "camera_motion", "dolly_zoom", "lens_fast_prime", "plane_approaching", "plane_turning",
        "road", "rolling_fan", "rolling_train", "tube", "wide_angle",
    ),
    "partly hidden points near the focus, corners, textures behind outlines": (
        "cat-eye, near card", "distortion below R 2", "hand_held", "lit", "occlusion_ground", "occlusion_tube",
        "stereo",
    ),
}  # fmt: skip
OCCLUSION_SCENES = {
    "near_sphere": "near sphere before a far plane, both blurred", "sharp_near": "sharp sphere, blurred plane",
    "sharp_far": "blurred sphere, sharp plane", "three": "sphere, cylinder, plane",
    "ground": "sphere standing on a floor", "interpenetrating": "two spheres through one another",
    "passing": "ball passing behind a pillar", "card": "card before a plane",
    "wire": "wire, thinner than its blur", "tube": "tube, seen inside", "alone": "one sphere, nothing overlaps",
}  # fmt: skip
CARD_CASES = (
    ("sphere, 512 x 512", "H100", "sphere, 512 x 512"),
    ("sphere, 1920 x 1080, R to 15 px", "H100", "sphere, 1920 x 1080"),
    ("sphere, 7680 x 4320, R to 58 px", "H100", "sphere, 7680 x 4320"),
    ("moving sphere, 5 samples, 512 x 512", "H100", "moving sphere, 5 samples, 512 x 512"),
    ("three objects that overlap, 1920 x 1080, R to 64 px", "H100", "three objects, visibility, 1920 x 1080"),
    (
        "`clsco.defocus`, depth layers, 8192 x 8192, R to 20 px", "H100",
        "clsco.defocus with depth layers, R to 20 px, 8192 x 8192",
    ),
    ("`rolling_train`", "H200", "example rolling_train"),
    ("`dolly_zoom`", "H200", "example dolly_zoom"),
    ("20 wires before a face, one sample", "H200", "fence, one sample"),
)  # fmt: skip


def result_rows(name: str) -> list[Row]:
    """Rows of all Markdown tables of a result file, by the names of their columns; `cost` gets that before it."""
    rows: list[Row] = []
    columns: list[str] = []
    for line in (RESULTS / name).read_text("utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")] if line.startswith("|") else []
        if not cells:
            columns = []
        elif not columns:
            before = ["", *cells[:-1]]
            columns = [
                f"cost of {b.strip('`')}" if name == "cost" else name for b, name in zip(before, cells, strict=True)
            ]
        elif not cells[0].startswith("---"):
            rows.append(dict(zip(columns, cells, strict=True)))
    return rows


def table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    head = list(columns)
    lines = ["| " + " | ".join(cells) + " |\n" for cells in [head, *rows]]
    return "".join([lines[0], "|---" * len(head) + "|\n", *lines[1:]])


def errors(settings: Mapping[str, str], scenes: Mapping[str, tuple[str, ...]]) -> str:
    """PSNR of whole frames in accuracy.md: rows by name of their setting, columns by names of their scenes."""
    rows = {row["setting"]: row for row in result_rows("accuracy.md")}

    def cells(setting: str) -> list[str]:
        columns = ([rows[setting][name].split(" / ")[0] for name in names] for names in scenes.values())
        return [settings[setting], *(", ".join(column) for column in columns)]

    return table(("settings", *scenes), map(cells, settings))


def still() -> str:
    return errors(STILL_SETTINGS, STILL_SCENES)


def moving() -> str:
    return errors(MOVING_SETTINGS, MOVING_SCENES)


def textures() -> str:
    rows = [row for row in result_rows("surface_textures.md") if row["frame 50"]]
    objects = dict.fromkeys(row["object"] for row in rows)
    ranges: dict[tuple[str, str], str] = {}
    for row in rows:
        figures = [float(row[name]) for name in row if name.startswith("frame ")]
        ranges[row["shutter"], row["object"]] = f"{min(figures)}, {max(figures)}"
    return table(("shutter", *objects), ([way, *(ranges[way, name] for name in objects)] for way in ("closed", "open")))


def judged() -> str:
    """Deviations of frames from rays by their causes, and the scenes without any."""
    rows = [row for row in result_rows("judged.md") if not row["dB"].startswith("not judged")]
    off = {row["scene"]: row for row in rows if not row["beyond"].startswith("0 ")}
    causes = {name: cause for cause, names in DEVIATION_CAUSES.items() for name in names}

    def span(group: Iterable[Row]) -> str:
        return " to ".join(dict.fromkeys(f"{end(float(row['dB']) for row in group)}" for end in (min, max)))

    def worst(row: Row) -> str:
        right, got = map(float, row["right, got"].split(", "))
        return f"`{row['scene']}` {abs(got - right):.2f}"

    groups = {cause: [row for name, row in off.items() if causes[name] == cause] for cause in DEVIATION_CAUSES}
    lines = [[cause, ", ".join(map(worst, group)), span(group)] for cause, group in groups.items()]
    others = [row for row in rows if row["scene"] not in off]
    lines.append(["none beyond 0.01", f"{len(others)} others", span(others)])
    return table(("cause", "scenes, with the worst pixel's deviation", "dB"), lines)


def occlusion() -> str:
    def cells(row: Row) -> list[str]:
        times = [row[name].rstrip("x") for name in ("cost of layered", "cost of visibility")]
        return [
            OCCLUSION_SCENES[row["scene"]],
            row["`none`"],
            row["`layered`"],
            times[0],
            row["`visibility`"],
            times[1],
        ]

    columns = ("scene", "`none`", "`layered`", "time", "`visibility`", "time")
    return table(columns, map(cells, result_rows("occlusion.md")))


def pictures() -> str:
    """PSNR within 12 px of depth edges: the middle one of three figures."""
    ways = ("filtered", "layers, filtered", "node, filtered")
    columns = ("scene", "R, px", "one picture", "two layers", "Defocus node")
    rows = result_rows("pictures.md")
    return table(columns, ([row["scene"], row["R"], *(row[way].split(" / ")[1] for way in ways)] for row in rows))


def memory() -> str:
    most = {row[""]: row["peak MiB"] for row in result_rows("sizes.md") if row["size, px"] == "8192"}
    return table(("8192 x 8192 px", "MiB"), ((label, f"{float(most[name]):.0f}") for label, name in MEMORY.items()))


def photographic() -> str:
    columns = (
        "scene", "", "`visibility`, s", "`--tolerance 0.003`, s", "RMS errors", "path tracer at 3e-3, s", "times less",
    )  # fmt: skip

    def error(text: str) -> str:
        return f"{float(text):.1e}".replace("e-0", "e-") if float(text) else SCATTER_ERROR

    def cells(row: Row) -> list[str]:
        tracers = [float(row[f"{name} at 0.003, s"]) for name in ("Mitsuba", "Cycles") if row[f"{name} at 0.003, s"]]
        times = [f"{float(row[f'{way}, s']):.3g}" for way in ("visibility", "tolerance")]
        errors = ", ".join(error(row[f"error of {way}"]) for way in ("visibility", "tolerance"))
        less = float(row["better one / clsco at 0.003"])
        return [
            SCENES[row["scene"]] * (row["motion"] == "still"),
            row["motion"],
            *times,
            errors,
            f"{min(tracers):.3g}",
            f"{less:.3g}",
        ]

    return table(columns, map(cells, result_rows("photographic.md")))


def mitsuba() -> str:
    with (RESULTS / "bench/lens.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["tool"] == "clsco"]

    def cells(row: Row) -> list[str]:
        about = "about " * (row["extrapolated"] == "True")
        less = float(f"{float(row['times_less']):.3g}")
        error = f"{float(row['rms_error']):.1e}".replace("e-0", "e-")
        times = f"{1000 * float(row['cpu_s']):.1f}", f"{about}{float(row['mitsuba_cpu_s']):.4g}"
        return [row["setting"], error, *times, f"{less:,.0f}"]

    return table(
        ("PSF", "RMS error", "clsco, ms", "Mitsuba, s", "times less"),
        (cells(row) for row in rows if row["setting"].startswith("integrated")),
    )


def numba() -> str:
    blurs: dict[tuple[str, str], list[str]] = {}
    for row in result_rows("defocus_speed.md"):
        time = float(row["prepass"]) + float(row["pass"])
        cell = f"{time:.3g}, {float(row['ratio_with_prepass']):.3g} times"
        blurs.setdefault((row["psf"], "gray" if row["channels"] == "1" else "color"), []).append(cell)
    rows = ([*names, *cells] for names, cells in blurs.items())
    return table(("PSF", "", "R up to 2 px", "6 px", "20 px"), rows)


def cards() -> str:
    times: dict[tuple[str, str], str] = {}
    for row in result_rows("gpu.md"):
        if "case" in row:
            times.setdefault((row["case"], row["device"]), f"{float(row['ms']):.{1 if float(row['ms']) < 10 else 0}f}")
    rows = ((label, times[case, "Xeon"], f"{card}: {times[case, card]}") for label, card, case in CARD_CASES)
    return table(("frame", "16 cores, ms", "card, ms"), rows)


def video() -> str:
    names = ("preset", "file", "codec", "pixels", "kB/frame", "largest error", "PSNR, dB")
    return table(names, ([f"`{row['preset']}`", *(row[name] for name in names[1:])] for row in result_rows("video.md")))


def inpainting() -> str:
    mean = next(row for row in result_rows("inpainting.md") if "mean" in row.get("case", ""))
    methods = {name: cell.split(" / ") for name, cell in mean.items() if " / " in cell}
    labels = {"thesis": "`mean-median`", "scikit-image": "scikit-image biharmonic", "Telea": "OpenCV Telea"}
    heads = [labels.get(name, f"`{name}`" if name.islower() else name) for name in methods]
    measures = (("PSNR in the holes, dB", ".1f"), ("SSIM in the holes", ".3f"), ("processor time, s", ".3g"))
    rows = (
        (what, *(f"{float(cell[place]):{digits}}" for cell in methods.values()))
        for place, (what, digits) in enumerate(measures)
    )
    return table(("", *heads), rows)


TABLES: dict[str, tuple[str, Callable[[], str]]] = {
    "still": ("accuracy.md", still), "moving": ("accuracy.md", moving), "textures": ("accuracy.md", textures),
    "judged": ("accuracy.md", judged), "occlusion": ("occlusion.md", occlusion),
    "memory": ("speed.md", memory), "photographic": ("speed.md", photographic), "mitsuba": ("speed.md", mitsuba),
    "numba": ("speed.md", numba), "cards": ("speed.md", cards), "presets": ("video.md", video),
    "methods": ("inpainting.md", inpainting), "pictures": ("blender.md", pictures),
}  # fmt: skip


def with_table(text: str, name: str, lines: str) -> str:
    """Text of a page, with its table of this name replaced."""
    before, mark, rest = text.partition(f"<!-- table: {name} -->\n")
    assert mark, name
    return f"{before}{mark}\n{lines}\n{END}{rest.partition(END)[2]}"


def main() -> None:
    for name, (page, make) in TABLES.items():
        path = DOCS / page
        path.write_text(with_table(path.read_text("utf-8"), name, make()), "utf-8")


if __name__ == "__main__":
    main()
