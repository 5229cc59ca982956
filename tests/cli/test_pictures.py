"""Pictures with depth as other programs write them: the layers and blur radii that `clsco defocus` reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray

import clsco
from clsco.files.images import read_image, write_png
from clsco.files.transfer import decode
from clsco.scene.model import Camera
from tests.command import clsco_, done

Array = NDArray[Any]
RNG = np.random.default_rng(8)
RGB = RNG.random((6, 8, 3)).astype(np.float16).astype(np.float32)  # halves store them exactly
ALPHA = np.tile(np.float32([0, 0, 0.5, 1, 1, 1, 0.25, 0]), (6, 1))
Z = np.full((6, 8), 4.0, np.float32)
Z[:, 3:6] = 2.0
LENS = ("--unit", "m", "--focal-length", "50mm", "--f-number", 2, "--focus-distance", "2m", "--pixel-pitch", "50um")
CAMERA = Camera(focal_length=50.0, f_number=2.0, focus_distance=2000.0, pixel_pitch=0.05)


def radii(z: Array, camera: Camera = CAMERA) -> Array:
    """R = s0 D / (2 p) (1 / u - 1 / Z), px."""
    return 50.0 * camera.aperture_diameter / 0.1 * (1.0 / camera.focused_distance - 1e-3 / np.float64(z))


def planes(prefix: str, image: Array, names: str = "RGB") -> dict[str, Array]:
    return {prefix + name: np.ascontiguousarray(np.atleast_3d(image)[..., k]) for k, name in enumerate(names)}


def save(path: Path, *parts: dict[str, Array], **header: Any) -> Path:
    """An EXR; of several parts if there is more than one mapping of channels."""
    header = {"type": OpenEXR.scanlineimage} | header
    if len(parts) == 1:
        OpenEXR.File(header, parts[0]).write(str(path))
    else:
        OpenEXR.File([OpenEXR.Part(dict(header), p, f"part{n}") for n, p in enumerate(parts)]).write(str(path))
    return path


class Engine:
    """Stands in for `clsco.defocus`: keeps its arguments, and returns the first layer."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[list[tuple[Array, Array]]] = []
        monkeypatch.setattr(clsco, "defocus", self)

    def __call__(self, image: Any = None, radius: Any = None, layers: Any = None, **_: Any) -> Array:
        self.calls.append(list(layers or [(image, radius)]))
        return self.calls[-1][0][0]


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> Engine:
    return Engine(monkeypatch)


OTHERS = planes("View.Normal.", RGB, "XYZ") | planes("View.DiffCol.", RGB[::-1]) | planes("View.UV.", RGB, "UVA")
BLENDER = (
    planes("View.Combined.", RGB) | {"View.Combined.A": np.ones((6, 8), np.float32), "View.Mist.Z": Z / 9} | OTHERS
)
COLORS = planes("", RGB)
KINDS: dict[str, Any] = {
    "Blender 4": (BLENDER | {"View.Depth.Z": Z},),
    "Blender 5": (BLENDER | {"View.Depth.V": Z},),
    "Blender 5, a part for each pass": (planes("View.Combined.", RGB), {"View.Mist.Z": Z / 9}, {"View.Depth.V": Z}),
    "Arnold, half": ({name: plane.astype(np.float16) for name, plane in (COLORS | {"Z": Z}).items()},),
    "Nuke": (COLORS | planes("diffuse.", RGB[::-1]) | {"depth.Z": Z},),
    "Nuke's words": ({f"fg.{name}": COLORS[name[0].upper()] for name in ("red", "green", "blue")} | {"fg.Z": Z},),
    "Houdini": (COLORS | {"Pz": Z} | planes("N.", RGB, "XYZ"),),
    "Unreal": (COLORS | planes("FinalImageWorldDepth.", np.dstack([Z] * 3)),),
    "V-Ray": (COLORS | {"ZDepth": Z},),
}


@pytest.mark.parametrize("tiled", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_file_of_image_and_depth(tmp_path: Path, engine: Engine, kind: str, tiled: bool) -> None:
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()} if tiled else {}
    path = save(tmp_path / "a.exr", *KINDS[kind], **header)
    result = done("defocus", path, "-o", tmp_path / "b.exr", *LENS)
    assert result.stderr == f"{path}: R 0 to 3.13 px; in focus: 37 % of the picture\n"
    (((image, radius),),) = engine.calls
    np.testing.assert_array_equal(image, RGB)
    np.testing.assert_allclose(radius, radii(Z), atol=1e-9)
    np.testing.assert_array_equal(read_image(tmp_path / "b.exr").data, RGB)


def test_overscan_feeds_the_border(tmp_path: Path) -> None:
    """A frame is the middle of a larger picture; overscan on one side alone goes on as a mirror image on the other."""
    image, z = RNG.random((24, 32, 3), np.float32), np.float32(RNG.uniform(2.0, 2.2, (24, 32)))
    channels = planes("", image) | {"Z": z}
    for name, first in (("whole", (0, 0)), ("inner", (8, 6)), ("left", (8, 0))):
        display = (first, (31 - first[0], 23 - first[1]))
        path = save(tmp_path / f"{name}.exr", channels, dataWindow=((0, 0), (31, 23)), displayWindow=display)
        done("defocus", path, "-o", tmp_path / f"{name}_out.exr", *LENS)
    whole, inner, left = (read_image(tmp_path / f"{name}_out.exr").data for name in ("whole", "inner", "left"))
    np.testing.assert_allclose(inner, whole[6:-6, 8:-8], atol=1e-6)
    np.testing.assert_allclose(left, whole[:, 8:-8], atol=1e-6)
    path = save(tmp_path / "small.exr", channels, dataWindow=((4, 4), (35, 27)), displayWindow=((0, 0), (39, 31)))
    result = done("defocus", path, "-o", tmp_path / "small_out.exr", *LENS)
    assert f"{path}: 512 of 1280 pixels have no depth (512 NaN)\n" in result.stderr


def test_depths_that_are_none_and_partly_covered_pixels(tmp_path: Path, engine: Engine) -> None:
    """Depths under alpha 0 are not used; half covered pixels with the background's get those of the nearest covered."""
    light = RGB * ALPHA[..., None]
    covered = ALPHA > 0
    for background in (100.0, 1e10, np.inf, np.nan, 0.0, -1.0):
        z = np.where(ALPHA == 1, Z, np.float32(background))
        z[:, 2] = z[:, 2] if np.isfinite(background) else np.nan
        path = save(tmp_path / "a.exr", planes("", np.dstack([light, ALPHA]), "RGBA") | {"Z": z})
        result = done("defocus", path, "-o", tmp_path / "b.exr", *LENS)
        assert f"{path}: 12 partly covered pixels get the depth of the nearest covered one\n" in result.stderr
        ((rgba, radius),) = engine.calls[-1]
        np.testing.assert_array_equal(rgba, np.dstack([light, ALPHA]))
        np.testing.assert_allclose(
            radius[covered], radii(Z)[:, 3:4].repeat(5, axis=1).ravel()[: covered.sum()], atol=1e-9
        )
    assert set(OpenEXR.File(str(tmp_path / "b.exr"), separate_channels=True).channels()) == set("RGBA")
    z = Z.copy()
    z[0] = np.nan, np.inf, -1, 0, 2, 2, 2, 2
    path = save(tmp_path / "a.exr", COLORS | {"Z": z})
    result = done("defocus", path, "-o", tmp_path / "b.exr", *LENS)
    assert "3 of 48 pixels have no depth (1 zero, 1 negative, 1 NaN), 1 is infinitely far\n" in result.stderr


def test_layers_and_their_blur(tmp_path: Path, engine: Engine) -> None:
    fg = save(tmp_path / "fg.exr", planes("", np.dstack([RGB * ALPHA[..., None], ALPHA]), "RGBA") | {"Z": Z})
    write_png(tmp_path / "plate.png", np.uint8(255 * RGB))
    write_png(tmp_path / "z.png", np.uint8(50 * Z))  # 8 bits
    words = ("--layer", f"{tmp_path / 'plate.png'}:{tmp_path / 'z.png'}", "--layer", fg, "--set", "object.0.scale=0.02")
    result = done("defocus", *words, "-o", tmp_path / "a.png", *LENS, "--max-blur", 2)
    assert "z.png: R of 30 of 48 pixels is clamped to 2 px\n" in result.stderr
    (back, far), (front, near) = engine.calls[-1]
    np.testing.assert_allclose(back[..., :3], decode(np.uint8(255 * RGB), "srgb"), atol=1e-6)
    np.testing.assert_array_equal(front[..., 3], ALPHA)
    np.testing.assert_allclose(far, np.minimum(radii(Z), 2.0), atol=1e-9)
    both = planes("V.FG.Combined.", np.dstack([RGB, ALPHA]), "RGBA") | {"V.FG.Depth.Z": Z, "V.BG.Depth.Z": Z + 1}
    path = save(tmp_path / "both.exr", both | planes("V.BG.Combined.", RGB[::-1]))
    done("defocus", path, "--layers", "V.FG,bg", "-o", tmp_path / "a.png", *LENS)
    (_, near), (back, far) = engine.calls[-1]
    np.testing.assert_array_equal(back[..., :3], RGB[::-1])
    np.testing.assert_allclose(near[ALPHA == 1], radii(Z)[ALPHA == 1], atol=1e-9)
    np.testing.assert_allclose(far, radii(Z + 1), atol=1e-9)


def test_a_sequence_with_a_focus_track(tmp_path: Path, engine: Engine) -> None:
    for number in (1, 2, 3, 7):
        save(tmp_path / f"shot_{number:04d}.exr", planes("", RGB + number) | {"Z": Z})
    (tmp_path / "track.csv").write_text("frame,distance\n1,2m\n3,4m\n")
    plate = save(tmp_path / "plate.exr", COLORS | {"Z": Z})
    words = ["--layer", tmp_path / "shot_####.exr", "--layer", plate, "-o", tmp_path / "out_%02d.exr", *LENS[:6]]
    words += ["--sensor-width", "0.4mm", "--frames", "1:4"]  # 50 um a pixel
    for track in ("1:2m,3:4m", tmp_path / "track.csv"):
        done("defocus", *words, "--focus-distance", track)
        for call, number, focus in zip(engine.calls[-3:], (1, 2, 3), (2000, 8000 / 3, 4000), strict=True):
            (image, radius), (still, _) = call
            np.testing.assert_array_equal(image[..., :3], RGB + number)
            np.testing.assert_array_equal(still[..., :3], RGB)
            np.testing.assert_allclose(radius, 12500 * (1 / focus - 1e-3 / Z.astype(np.float64)), atol=1e-9)
    assert sorted(file.name for file in tmp_path.glob("out*")) == ["out_01.exr", "out_02.exr", "out_03.exr"]


def test_bad_files_give_one_line(tmp_path: Path, engine: Engine) -> None:
    alpha = save(tmp_path / "alpha.exr", planes("", np.dstack([RGB, ALPHA]), "RGBA") | {"Z": Z})
    flat = save(tmp_path / "flat.exr", COLORS | OTHERS)
    two = save(tmp_path / "two.exr", planes("a.", RGB) | planes("b.", RGB) | {"Z": Z})
    small = save(tmp_path / "small.exr", {"Z": Z[:4]})
    good = save(tmp_path / "s_1.exr", COLORS | {"Z": Z})
    rule = "must hold a channel Z or Pz, or a layer with depth in its name; got B G R View.DiffCol View.Normal View.UV"
    cases: list[tuple[list[Any], int, str]] = [
        ([flat], 1, f"{flat}: an EXR of image and depth {rule}"),
        ([two], 1, f"{two}: an EXR must hold one image, or its layer must be named; got layers a b"),
        (["--layer", f"{flat}:{small}"], 1, f"{small}: the size must be that of {flat}, 8 x 6 pixels; got 8 x 4"),
        ([alpha], 1, "a.png: must end in .exr, which holds alpha, as no layer is opaque; got '.png'"),
        ([good, "--set", "sensor={}"], 1, "use the sections camera, aperture, psf and image alone; got sensor"),
        ([good, "--focus-distance", "3"], 1, "must be greater than focal_length = 50 mm; got 3 mm (3 m?)"),
        ([good, "--focus-distance", "1:3m"], 2, "distances by frame need a sequence"),
        ([good, "--focus-distance", "3 parsec"], 2, "must be a length, in mm or with a unit"),
        ([good, "--focus-distance", "1:3m,3m"], 2, "like 1:3m,48:5m, or a CSV file of these; got 1:3m,3m"),
        ([good, "--fov", "40deg", "--sensor-width", "36mm"], 1, "must be only one of them"),
        ([good, "--layer", flat], 2, "must be IMAGE [DEPTH], or --layer"),
        ([tmp_path / "s_#.exr"], 1, "a sequence needs numbers in OUT and in IMAGE or a layer"),
        ([tmp_path / "s_#.exr", "--frames", "1:4", "-o", tmp_path / "b_#.exr"], 1, "for each frame; got none for 2 3"),
    ]
    for words, status, message in cases:
        result = clsco_("defocus", "-o", tmp_path / "a.png", *LENS[:6], *words)
        assert (result.exit_code, result.stdout, result.stderr.count("error: ") + result.stderr.count("Error: ")) == (
            status,
            "",
            1,
        )
        assert message in result.stderr
    assert not engine.calls
