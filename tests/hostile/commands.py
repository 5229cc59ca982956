"""Bad command lines, listed, and the folder in which they run: what is typed, the exit status, and what it names."""

from __future__ import annotations

import os
import struct
import zlib
from functools import cache
from pathlib import Path

import numpy as np

from tests.hostile.pictures import samples

SCENE = '[camera]\nresolution = [12, 9]\n[[object]]\nshape = "plane"\n'
TEXTURE = '[camera]\nresolution = [12, 9]\n[[object]]\nshape = "plane"\ntexture = "{}"\n'
DEPTH = '[camera]\nresolution = [12, 9]\n[[object]]\nshape = "depth_map"\ntexture = "image.png"\ndepth = "{}"\n'
# What a texture or a depth may not be: name of the file in the scene.
NO_FILES = (
    "none.png", "folder", "folder.png", "pipe.png", "loop.png", "/dev/zero", "/dev/null", "/proc/self/mem",
    "/proc/self/environ", "..", "/", "../good.toml", "empty.png", "text.png", "bomb.png", "cut.png", "jpeg.png",
    "image.bmp", "no_extension", "a" * 300 + ".png", "a/" * 400 + "b.png", "nan.npy", "objects.npy", "flat.npy",
    "volume.npy", "~/image.png", "$HOME/image.png", "http://localhost/image.png", "image.png/x.png",
)  # fmt: skip
# Scene files, by the name of a file in the folder.
NO_SCENES = (
    "none.toml", "folder.toml", "pipe.toml", "loop.toml", "dangling.toml", "empty.toml", "latin.toml", "large.toml",
    "deep.toml", "deep.json", "dots.toml", "twice.toml", "twice.json", "list.json", "number.json", "cut.toml",
    "bom16.toml", "image.png", "/dev/zero", "/dev/null", "..", "/", "a" * 300 + ".toml", "new\nline.toml", "nul.toml",
    "null.json", "escape.toml", "empty.json", "/proc/self/mem.toml", "good.toml/x.toml", "GOOD.TXT",
)  # fmt: skip
NO_FOLDERS = (
    "good.toml", "pipe.png", "loop.png", "/proc/out", "/dev/null", "a" * 300, "good.toml/out",
    "/".join(["a" * 200] * 30),
)  # fmt: skip
NO_OVERRIDES = (
    "", "=", "=3", "camera", "camera.", ".f_number=3", "camera..f_number=3", "title.x=3", "object.1.radius=3",
    "object.x=3", "object[1].radius=3", "object.9999999999999999999999.x=1", "object." + "9" * 5000 + ".x=1",
    "camera.f_number=", "camera.f_number=x", "camera.f_number=[", "camera=3", "camera.f_number=[[[[",
    "camera.f_number=" + "[" * 3000, "camera.f_number=nan", "camera.f_number=" + "9" * 5000, "x" + ".y" * 3000 + "=1",
    "camera.f_number={a" + ".a" * 90 + "=1}", "camera\n.f_number=3", "\x1b[2J=3", "object=[]",
    "camera.f_number=3\n[psf]", "camera.resolution=[0,0]", "sequence.frames=0", "sequence.frames=1e9", "psf.model=disc",
    "object.0.texture=", "object.0.shape=cube", "é=1", "__proto__.x=1",
)  # fmt: skip
NO_SIZES = ("", "0", "-1", "nan", "inf", "1e9", "GiB", "1 PiB", "1.5.0MB", "lots", "0x10", "９MB", "0.1B", "9" * 400)
NO_SPANS = ("", "1", "a:b", "-1:2", "0:0x2", "1:1:1", "９:", ":" * 3, "0:" + "9" * 40, "0.5:1", " 0:1 ", "0:1\n")
OUTSIDE_SPANS = ("1:1", "5:", "0:2", ":0", "0:999999999", "1:0")
NO_NUMBERS = ("", "x", "1,5", "1/0", "--", "1e", "0x10")


def lay_out(folder: Path) -> None:
    """Files, folders, pipes and links for the command lines."""
    (folder / "good.toml").write_text(SCENE)
    (folder / "GOOD.TXT").write_text(SCENE)
    for name in ("folder", "folder.png", "folder.toml", "elsewhere"):
        (folder / name).mkdir()
    for name in ("pipe.png", "pipe.toml", "pipe.npy"):
        os.mkfifo(folder / name)
    for name in ("loop.png", "loop.toml"):
        (folder / name).symlink_to(name)
    (folder / "dangling.toml").symlink_to("nowhere.toml")
    (folder / "link_out").mkdir()
    (folder / "link_out" / "f_number_3").symlink_to("../elsewhere")
    suffixes = {
        "image.png": "gray png",
        "color.png": "color png",
        "jpeg.png": "jpeg",
        "image.bmp": "gray png",
        "no_extension": "gray png",
    }
    for name, sample in suffixes.items():
        (folder / name).write_bytes(samples()[sample][1])
    image = samples()["gray png"][1]
    contents: dict[str, bytes] = {
        "empty.png": b"", "text.png": b"hello", "cut.png": image[:60], "bomb.png": bomb(), "empty.toml": b"",
        "latin.toml": b'title = "\xe9"', "large.toml": b"#" * (2**20 + 1),
        "deep.toml": b"a = " + b"[" * 3000 + b"]" * 3000, "deep.json": b"[" * 100_000, "empty.json": b"",
        "dots.toml": b"a" + b".a" * 5000 + b" = 1", "twice.toml": SCENE.encode() * 2,
        "twice.json": b'{"camera": {}, "camera": {}}', "list.json": b"[1]", "number.json": b"3", "null.json": b"null",
        "cut.toml": SCENE.encode()[:20], "bom16.toml": SCENE.encode("utf-16"), "new\nline.toml": b"x = 1",
        "nul.toml": b"a = \0", "escape.toml": b'"\x1b[2J" = 1',
    }  # fmt: skip
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    arrays = {
        "nan.npy": np.full((9, 12), np.nan), "flat.npy": np.ones(9), "volume.npy": np.ones((9, 12, 5)),
        "depth.npy": np.full((9, 12), 300.0),
        "small.npy": np.full((3, 3), 300.0), "negative.npy": np.full((9, 12), -1.0), "near.npy": np.full((9, 12), 1e-3),
    }  # fmt: skip
    for name, array in arrays.items():
        np.save(folder / name, array)
    np.save(folder / "objects.npy", np.array([[{}]]), allow_pickle=True)
    np.save(folder / "mask.npy", np.eye(9, 12, dtype="u1") * np.uint8(255))
    np.save(folder / "gray_mask.npy", np.full((9, 12), 7, "u1"))
    np.save(folder / "full_mask.npy", np.full((9, 12), 255, "u1"))


@cache
def bomb() -> bytes:
    """A PNG of 13,000 x 13,000 black pixels in 164 kB."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    packer = zlib.compressobj(9, wbits=-15)
    rows = packer.compress(bytes(1000 * 13_001)) + packer.flush(zlib.Z_FULL_FLUSH)  # which may be repeated
    checksum = 13_000 * 13_001 % 65_521 << 16 | 1
    body = b"\x78\xda" + 13 * rows + b"\3\0" + struct.pack(">I", checksum)
    head = struct.pack(">IIBBBBB", 13_000, 13_000, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


# Words, exit status, and what stderr must name; {0} stands for each of the values.
Table = tuple[tuple[str, tuple[str, ...], int, str], ...]
TABLE: Table = (
    ("validate {0}", NO_SCENES, 1, "{0}"),
    ("render good.toml {0} -o out", NO_SCENES[:20], 1, "{0}"),
    ("plan {0}", NO_SCENES[:20], 1, "{0}"),
    ("render good.toml -o {0}", NO_FOLDERS, 1, "{0}"),
    ("demo -o {0}", NO_FOLDERS, 1, "{0}"),
    ("render good.toml -o out --set {0}", NO_OVERRIDES, 1, ""),
    ("plan good.toml --set {0}", NO_OVERRIDES, 1, ""),
    ("render good.toml -o out --memory {0}", NO_SIZES, 2, "--memory"),
    ("plan good.toml --memory {0}", NO_SIZES, 2, "--memory"),
    ("render good.toml -o out --frames {0}", NO_SPANS[1:], 2, "--frames"),
    ("render good.toml -o out --frames {0}", OUTSIDE_SPANS, 1, "frames"),
    ("render good.toml -o out --truth {0}", ("x", "depth;coc", "depth, coc", "DEPTH", "npz,", "tif", "npz,x"), 2, "--"),
    ("render good.toml -o out --format {0}", ("x", "npz;exr", "npz, exr", "NPZ", ",", "npz,", "tif", "npz+zip",
        "npz+float16", "npz,npz+compressed"), 2, "--format"),
    ("render good.toml -o out --truth depth --types {0}", ("x", "depth", "depth=int", "all=float8"), 2, "--types"),
    ("render good.toml -o out --precision {0}", ("", "half", "Double", "64"), 2, "--precision"),
    ("render good.toml -o out --method {0}", ("auto", "gather"), 2, "--method"),
    ("render good.toml -o out --tolerance {0}", ("0", "-1", "x", ""), 2, "--tolerance"),
    ("render good.toml -o out --tolerance {0}", ("nan", "inf"), 1, "tolerance"),
    ("render good.toml -o out --device {0}", ("no such device", "\n", "\x1b[2J", "é", "9" * 5000), 3, "--device"),
    ("{0}", ("render", "render good.toml", "render -o out", "plan", "check", "defocus image.png",
        "inpaint image.png", "validate", "x", "--x"), 2, ""),
    ("render good.toml -o out {0}", ("--set", "--frames", "--x", "-q", "--memory", "--truths"), 2, "{0}"),
    ("render good.toml -o link_out --set {0}", ("camera.f_number=[3,4]",), 1, "f_number_3"),
    ("render good.toml ./good.toml -o {0}", ("out",), 1, "good.toml"),
    ("defocus {0} depth.npy -o out.png", NO_FILES[:20], 1, "{0}"),
    ("defocus image.png {0} -o out.png", (*NO_FILES[:20], *NO_FILES[22:26], "small.npy", "negative.npy", "near.npy"), 1,
        "{0}"),
    ("defocus image.png depth.npy -o {0}", ("image.png", "depth.npy", "out.bmp", "out.jpg", ), 1, "{0}"),
    ("defocus image.png depth.npy -o {0}/out.png", NO_FOLDERS[1:4], 1, "{0}"),
    ("defocus image.png depth.npy -o out.png --unit {0}", ("", "cm", "MM", "px"), 1, "unit"),
    ("defocus image.png depth.npy -o out.png --scale {0}", NO_NUMBERS, 2, "--scale"),
    ("defocus image.png depth.npy -o out.png --scale {0}", ("0", "-1e99", "nan", "inf", "1e99", "0/1"), 1, "scale"),
    ("defocus image.png depth.npy -o out.png --f-number {0}", NO_NUMBERS[:3], 2, "--f-number"),
    ("defocus image.png depth.npy -o out.png --f-number {0}", ("0", "-1", "nan", "inf", "1e99"), 1, "f_number"),
    ("defocus image.png depth.npy -o out.png --focal-length {0}", ("0", "-1", "nan", "inf", "1e99"), 1, "focal_length"),
    ("defocus image.png depth.npy -o out.png --pixel-pitch {0}", ("0", "-1", "nan", "inf", "1e99"), 1, "pixel_pitch"),
    ("defocus image.png depth.npy -o out.png --focus-distance {0}", ("0", "-1", "nan", "-inf", "20"), 1,
        "focus_distance"),
    ("defocus image.png depth.npy -o out.png --truth {0}", ("npz",), 2, "--truth"),
    ("inpaint {0} mask.npy -o out.png", NO_FILES[:20], 1, "{0}"),
    ("inpaint image.png {0} -o out.png", (*NO_FILES[:20], "small.npy", "gray_mask.npy", "full_mask.npy", "color.png"),
        1, "{0}"),
    ("inpaint image.png mask.npy -o {0}", ("image.png", "mask.npy", "out", "out.bmp", "out.exr", "folder.png"), 1,
        "{0}"),
    ("inpaint image.png mask.npy -o out.png --method {0}", ("", "x", "Auto", "telea"), 1, "method"),
    ("inpaint image.png mask.npy -o out.png --threshold {0}", ("nan", "inf"), 1, "threshold"),
    ("inpaint image.png mask.npy -o out.png --method mean-median --border-share {0}", ("-1", "nan", "inf", "2"), 1,
        "--border-share"),
    ("inpaint image.png mask.npy -o out.png --method mean-median --minimum {0}", ("-1", "0", "9", "99999999999999"), 1,
        "--minimum"),
    ("inpaint image.png mask.npy -o out.png --method mean-median --estimator {0}", ("", "x", "mode"), 1, "--estimator"),
    ("inpaint image.png mask.npy -o out.png --minimum {0}", ("3",), 1, "--minimum"),
)  # fmt: skip


def command_lines() -> list[tuple[list[str], int, str]]:
    """Words, exit status and what stderr must name, of each bad command line."""
    found = []
    for words, values, status, named in TABLE:
        for value in values:
            given = [word.replace("{0}", value) for word in words.split()]
            if words == "{0}":
                given = value.split()
            found.append((given, status, named.format(value)))
    return found


def bad_files(folder: Path) -> list[tuple[Path, str]]:
    """Write a scene for each texture and depth that cannot be; the scene's path and the key that must be named."""
    found = []
    for text, key in ((TEXTURE, "object[0].texture"), (DEPTH, "object[0].depth")):
        for number, name in enumerate(NO_FILES):
            path = folder / f"{key[10:]}_{number}.toml"
            path.write_text(text.format(name))
            found.append((path, key))
    return found
