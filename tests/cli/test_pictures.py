"""Pictures with depth as other programs write them: the layers and blur radii that `clsco defocus` reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray

import clsco
from clsco.engine.defocus import DefocusReport
from clsco.files.images import read_image, write_png
from clsco.files.transfer import decode
from tests.command import clsco_, done
from tests.files.test_layers import layer, save

Array = NDArray[Any]
RGB = np.random.default_rng(8).random((6, 8, 3)).astype(np.float16).astype(np.float32)  # halves store them exactly
CODES = (255 * RGB).astype(np.uint8)
ALPHA = np.tile(np.array([0, 0, 0.5, 1, 1, 1, 0.25, 0], np.float32), (6, 1))
RGBA = np.dstack([RGB * ALPHA[..., None], ALPHA])
Z = np.full((6, 8), 4.0, np.float32)
Z[:, 3:6] = 2.0
CAMERA = ("--unit", "m", "--focal-length", "50mm", "--f-number", 2)
LENS = (*CAMERA, "--focus-distance", "2m", "--pixel-pitch", "50um")


def check_radius(radius: Array, z: Array, focus: float = 2.0) -> None:
    """Compare with R = f D / (2 p) (1 / u - 1 / Z)."""
    np.testing.assert_allclose(radius, 12.5 * (1.0 / focus - 1.0 / z.astype(np.float64)), atol=1e-9)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[list[tuple[Array, Array]]]:
    """Layers of each call of `clsco.defocus`, whose place is taken by a function that returns the first layer."""
    layers_of_calls: list[list[tuple[Array, Array]]] = []

    def defocus(image: Any = None, blur_radius: Any = None, layers: Any = None, **_: Any) -> Any:
        layers_of_calls.append(list(layers or [(image, blur_radius)]))
        return (layers[0][0], DefocusReport(3)) if layers else (image, DefocusReport(0))

    monkeypatch.setattr(clsco, "defocus", defocus)
    return layers_of_calls


COLORS = layer("", RGB)
OTHERS = layer("View.Normal.", RGB, "XYZ") | layer("View.DiffCol.", RGB[::-1]) | layer("View.UV.", RGB, "UVA")
MANY = {f"L{n}.{name}": Z for n in range(5) for name in "XY"}
BLENDER = layer("View.Combined.", np.dstack([RGB, 0.9995 + 0 * Z]), "RGBA") | {"View.Mist.Z": Z / 9} | OTHERS
KINDS: dict[str, Any] = {
    "Blender 4": (BLENDER | {"View.Depth.Z": Z},),
    "Blender 5": (BLENDER | {"View.Depth.V": Z},),
    "Blender 5, a part for each pass": (layer("View.Combined.", RGB), {"View.Mist.Z": Z / 9}, {"View.Depth.V": Z}),
    "Arnold, half": ({name: plane.astype(np.float16) for name, plane in (COLORS | {"Z": Z}).items()},),
    "Nuke": (COLORS | layer("diffuse.", RGB[::-1]) | {"depth.Z": Z},),
    "Nuke's words": ({f"fg.{name}": COLORS[name[0].upper()] for name in ("red", "green", "blue")} | {"fg.Z": Z},),
    "Houdini": (COLORS | {"Pz": Z} | layer("N.", RGB, "XYZ"),),
    "Unreal": (COLORS | layer("FinalImageWorldDepth.", np.dstack([Z] * 3)),),
    "V-Ray": (COLORS | {"ZDepth": Z},),
}


@pytest.mark.parametrize("tiled", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_file_of_image_and_depth(tmp_path: Path, calls: list[Any], kind: str, tiled: bool) -> None:
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()} if tiled else {}
    path = save(tmp_path / "a.exr", *KINDS[kind], names=("a", "b", "c")[: len(KINDS[kind]) // 2 * 3], **header)
    result = done("defocus", path, "-o", tmp_path / "b.exr", *LENS)
    assert result.stderr == f"{path}: R 0 to 3.13 px; in focus: 37 % of the picture\n"
    (((image, radius),),) = calls
    np.testing.assert_array_equal(image, RGB)
    check_radius(radius, Z)
    np.testing.assert_array_equal(read_image(tmp_path / "b.exr").data, RGB)


def test_overscan_feeds_the_border(tmp_path: Path) -> None:
    """A frame is the middle of a larger picture; overscan on one side alone goes on as a mirror image on the other."""
    image, z = RGB.repeat(4, axis=0).repeat(4, axis=1), 2.0 + 0.2 * RGB[..., 0].repeat(4, axis=0).repeat(4, axis=1)
    blurred = []
    for left, top in ((0, 0), (8, 6), (8, 0)):
        window: Any = {"dataWindow": ((0, 0), (31, 23)), "displayWindow": ((left, top), (31 - left, 23 - top))}
        path = save(tmp_path / "a.exr", layer("", image) | {"Z": z}, **window)
        done("defocus", path, "-o", tmp_path / "b.exr", *LENS)
        blurred.append(read_image(tmp_path / "b.exr").data)
    np.testing.assert_allclose(blurred[1], blurred[0][6:-6, 8:-8], atol=1e-6)
    np.testing.assert_allclose(blurred[2], blurred[0][:, 8:-8], atol=1e-6)


def test_depths_that_are_none_and_partly_covered_pixels(tmp_path: Path, calls: list[Any]) -> None:
    """Depths under alpha 0 are not used; partly covered pixels with the background's get that of a covered one."""
    for background in (100.0, 1e10, np.inf, np.nan, 0.0, -1.0):
        z = np.where(ALPHA == 1, Z, np.float32(background)).astype(np.float32)
        path = save(tmp_path / "a.exr", layer("", RGBA, "RGBA") | {"Z": z})
        result = done("defocus", path, "-o", tmp_path / "b.exr", *LENS)
        assert f"{path}: 12 partly covered pixels get the depth of the nearest covered one\n" in result.stderr
        ((image, radius),) = calls[-1]
        np.testing.assert_array_equal(image, RGBA)
        check_radius(radius, np.full((6, 8), 2.0))
    assert set(OpenEXR.File(str(tmp_path / "b.exr"), separate_channels=True).channels()) == set("RGBA")
    z = Z.copy()
    z[0] = np.nan, np.inf, -1, 0, 2, 2, 2, 2
    result = done("defocus", save(tmp_path / "a.exr", COLORS | {"Z": z}), "-o", tmp_path / "b.exr", *LENS)
    assert "3 of 48 pixels have no depth (1 zero, 1 negative, 1 NaN), 1 is infinitely far\n" in result.stderr


def test_layers_in_files_and_in_one_file(tmp_path: Path, calls: list[Any]) -> None:
    fg = save(tmp_path / "fg.exr", layer("", RGBA, "RGBA") | {"Z": Z})
    write_png(tmp_path / "plate.png", CODES)
    write_png(tmp_path / "z.png", (50 * Z).astype(np.uint8))
    words = ("--layer", f"{tmp_path / 'plate.png'}:{tmp_path / 'z.png'}", "--layer", fg, "--set", "object.0.scale=0.02")
    result = done("defocus", *words, "-o", tmp_path / "a.png", *LENS, "--max-blur", 2)
    assert "z.png: R of 30 of 48 pixels is clamped to 2 px\n" in result.stderr
    assert "layers: 3 of 96 pixels at soft edges get the depth of one side\n" in result.stderr
    (back, far), (front, near) = calls[-1]
    np.testing.assert_allclose(back, np.dstack([decode(CODES, "srgb"), Z > 0]), atol=1e-6)
    np.testing.assert_array_equal(front, RGBA)
    np.testing.assert_array_equal(far, np.where(Z == 4, 2.0, far))
    both = layer("V.FG.Combined.", RGBA, "RGBA") | {"V.FG.Depth.Z": Z, "V.BG.Depth.Z": Z + 1}
    path = save(tmp_path / "both.exr", both | layer("V.BG.Combined.", RGB[::-1]))
    done("defocus", path, "--layers", "V.FG,bg", "-o", tmp_path / "a.png", *LENS)
    (front, near), (back, far) = calls[-1]
    np.testing.assert_array_equal(front, RGBA)
    np.testing.assert_array_equal(back[..., :3], RGB[::-1])
    check_radius(near[:, 3:6], Z[:, 3:6])
    check_radius(far, Z + 1)


def test_blur_radii_beyond_the_limit(tmp_path: Path, calls: list[Any]) -> None:
    radius = np.linspace(-400, 700, 48, dtype=np.float32).reshape(6, 8)
    np.save(tmp_path / "coc.npy", -2 * radius)
    write_png(tmp_path / "a.png", CODES)
    words = tmp_path / "a.png", tmp_path / "coc.npy", *LENS, "--unit", "coc", "--scale", -0.5, "--max-blur", 3
    result = done("defocus", *words, "-o", tmp_path / "b.png")
    assert "coc.npy: R of 47 of 48 pixels is clamped to 3 px\n" in result.stderr
    np.testing.assert_allclose(calls[-1][0][1], np.clip(radius, -3, 3), rtol=1e-6)


def test_a_sequence_with_a_focus_track(tmp_path: Path, calls: list[Any]) -> None:
    for number in (1, 2, 3, 7):
        save(tmp_path / f"shot_{number:04d}.exr", layer("", RGB + number) | {"Z": Z})
    (tmp_path / "track.csv").write_text("frame,distance\n1,2m\n3,4m\n")
    words = ["--layer", tmp_path / "shot_####.exr", "--layer", save(tmp_path / "plate.exr", COLORS | {"Z": Z})]
    words += ["-o", tmp_path / "out_%02d.exr", *CAMERA, "--sensor-width", "0.4mm", "--frames", "1:4"]
    for track in ("1:2m,3:4m", tmp_path / "track.csv"):
        done("defocus", *words, "--focus-distance", track)
        for ((image, radius), (still, _)), number, focus in zip(calls[-3:], (1, 2, 3), (2, 8 / 3, 4), strict=True):
            np.testing.assert_array_equal(image[..., :3], RGB + number)
            np.testing.assert_array_equal(still[..., :3], RGB)
            check_radius(radius, Z, focus)
    assert sorted(file.name for file in tmp_path.glob("out*")) == ["out_01.exr", "out_02.exr", "out_03.exr"]


def test_bad_files_give_one_line(tmp_path: Path, calls: list[Any]) -> None:
    flat, small = save(tmp_path / "flat.exr", COLORS | OTHERS | MANY), save(tmp_path / "small.exr", {"Z": Z[:4]})
    two = save(tmp_path / "two.exr", layer("a.", RGB) | layer("b.", RGB) | {"Z": Z})
    good, numbered = save(tmp_path / "s_1.exr", layer("", RGBA, "RGBA") | {"Z": Z}), tmp_path / "s_#.exr"
    rule = (
        "must hold a channel Z or Pz, or a layer with depth in its name; got B G L0 L1 L2 L3 L4 R View.DiffCol View.N"
    )
    cases: list[tuple[list[Any], int, str]] = [
        ([flat], 1, f"{flat}: an EXR of image and depth {rule}"),
        ([two], 1, f"{two}: an EXR must hold one image, or its layer must be named; got layers a b"),
        (["--layer", f"{flat}:{small}"], 1, f"{small}: the size must be that of {flat}, 8 x 6 pixels; got 8 x 4"),
        ([good], 1, "a.png: must end in .exr, which holds alpha, as no layer is opaque; got '.png'"),
        ([good, "--set", "sensor={}"], 1, "use the sections camera, aperture, psf and image alone; got sensor"),
        ([good, "--focus-distance", "3"], 1, "must be greater than focal_length = 50 mm; got 3 mm (3 m?)"),
        ([good, "--focus-distance", "1:3m"], 2, "distances by frame need a sequence"),
        ([good, "--focus-distance", "3 parsec"], 2, "must be a length, in mm or with a unit"),
        ([good, "--focus-distance", "1:3m,3m"], 2, "like 1:3m,48:5m, or a CSV file of these; got 1:3m,3m"),
        ([good, "--focus-distance", "1:0m"], 2, "a CSV file of these; got 1:0m"),
        ([good, "--max-blur", "nan"], 2, "'--max-blur': must be a number; got nan"),
        ([good, "--focus-depth", "nan"], 2, "'--focus-depth': must be a number; got nan"),
        ([good, "--focus-distance", "no.csv"], 2, "a CSV file of these; got no.csv: No such file or directory"),
        ([good, "--fov", "40deg", "--sensor-width", "36mm"], 1, "must be only one of them"),
        ([good, "--layer", flat], 2, "must be IMAGE [DEPTH], or --layer"),
        ([tmp_path / "no" / "s_#.exr", "-o", tmp_path / "b_#.exr"], 1, "a file for each frame; got none for any"),
        ([numbered], 1, "a sequence needs numbers in OUT and in IMAGE or a layer"),
        ([numbered, "--frames", "1:4", "-o", tmp_path / "b_#.exr"], 1, "for each frame; got none for 2 3"),
    ]
    for words, status, message in cases:
        result = clsco_("defocus", "-o", tmp_path / "a.png", *CAMERA, *words)
        assert (result.exit_code, result.stdout, result.stderr.lower().count("error: ")) == (status, "", 1)
        assert message in result.stderr
    assert not calls
