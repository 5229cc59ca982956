"""The lens on arrays: against the reference's scatter, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyopencl.array as cl_array
import pytest
from numpy.typing import NDArray

import clsco
from clsco.engine.defocus import defocus
from clsco.errors import ClscoError
from clsco.opencl.device import choose
from clsco.opencl.session import Session
from clsco.optics.resolved_view import guard_band
from clsco.reference.blur.blur import prepare_sources, scatter
from clsco.reference.layered.layered import over
from clsco.reference.trace.trace import Sources
from clsco.scene.model import Psf
from tests.slow import mostly_slow
from tests.spreads import layered_before_black, spec_of

Array = NDArray[Any]
# Float32 weights and sums over some hundred taps leave about 1e-6 of white, interpolation in the tables as much.
FIGURE = 1e-5


def reference(image: Array, coc: Array, psf: Psf) -> Array:
    valid = np.ones(coc.shape, bool)
    values = np.asarray(image, np.float64).reshape(*coc.shape, -1)
    sources = Sources(values, np.ones(coc.shape), valid.astype(np.uint8), coc, prepare_sources(coc, valid), valid)
    return np.asarray(scatter(spec_of(psf), sources, None, coc.shape, 0)).reshape(image.shape)


def apart(image: Array, coc: Array, psf: Psf | None = None, method: str = "auto") -> Array:
    """Each pixel by itself, and nothing beyond the border: the sum that the reference makes."""
    plain = (psf or Psf()).model_copy(update={"occlusion": "none"})
    return defocus(image, coc, plain, method=method, outside="black")


def picture(rows: int, columns: int, channels: int = 1) -> tuple[Array, Array]:
    rng = np.random.default_rng(7)
    image = rng.random((rows, columns, channels) if channels > 1 else (rows, columns), dtype=np.float32)
    i, j = np.mgrid[0:rows, 0:columns]
    coc = 5.0 * np.sin(0.07 * j) * np.cos(0.05 * i) + 0.02 * i
    assert np.ptp(coc) > 1.0
    return image, coc


PSFS = [
    Psf(model=model, edge=edge, tilt=tilt)
    for model in ("pillbox", "gaussian")
    for edge in ("sampled", "area", "integrated")
    for tilt in (False, True)
]


KEPT = [PSFS[k] for k in (0, 5, 8)]  # with and without tilt, each edge, both models


NARROW = [("gather", PSFS[1]), ("gather", PSFS[6]), ("scatter", PSFS[5]), ("tiles", PSFS[5])]


@pytest.mark.parametrize("kind", [np.float32, np.float16, np.int8, np.uint16])
@pytest.mark.parametrize(
    ("method", "psf"), mostly_slow(NARROW, NARROW[:1]), ids=lambda it: it if isinstance(it, str) else it.edge
)
def test_radii_of_few_bits_are_blurred_as_those_of_many(method: str, psf: Psf, kind: type[np.generic]) -> None:
    """Kernels read them as floats where they are, others as doubles."""
    for rows, columns in ((33, 90), (1, 40)):
        image, coc = picture(70, 90)
        image, narrow = image[:rows, :columns], np.abs(coc[:rows, :columns]).astype(kind)
        np.testing.assert_array_equal(
            defocus(image, narrow, psf, method=method), defocus(image, narrow.astype(np.float64), psf, method=method)
        )


@pytest.mark.parametrize("method", mostly_slow(["gather", "scatter"], ["gather"]))
@pytest.mark.parametrize("psf", mostly_slow(PSFS, KEPT), ids=lambda p: f"{p.model}-{p.edge}-{p.tilt}")
def test_every_psf_agrees_with_the_reference(psf: Psf, method: str) -> None:
    image, coc = picture(70, 90)
    error = np.abs(apart(image, coc, psf, method) - reference(image, coc, psf))
    worst = np.unravel_index(int(error.argmax()), error.shape)
    assert error.max() < FIGURE, f"{error.max():.2e} at {worst}, {(error > FIGURE).sum()} pixels"


@pytest.mark.parametrize("channels", mostly_slow([2, 3, 4], [3]))
def test_channels_are_blurred_alike(channels: int) -> None:
    image, coc = picture(40, 50, channels)
    method = "tiles" if choose().kind == "gpu" else "gather"  # of cards, each number of channels may have another
    result = defocus(image, coc, method=method)
    for k in range(channels):
        assert np.array_equal(result[..., k], defocus(np.ascontiguousarray(image[..., k]), coc, method=method))


@pytest.mark.parametrize("psf", mostly_slow(PSFS[::2], [PSFS[4]]), ids=lambda p: f"{p.model}-{p.edge}")
@pytest.mark.parametrize("radius", [0.3, -2.7, 9.4])
def test_one_radius_is_a_convolution(psf: Psf, radius: float) -> None:
    image, _ = picture(45, 61)
    coc = np.full(image.shape, radius)
    expected = reference(image, coc, psf)
    for method in ("auto", "convolve", "gather", "scatter"):
        if method == "convolve" or abs(radius) > 0.5 or method == "auto":
            assert np.abs(apart(image, coc, psf, method) - expected).max() < FIGURE, method


@pytest.mark.parametrize("method", mostly_slow(["gather", "scatter"], ["gather"]))
@pytest.mark.parametrize("psf", mostly_slow(PSFS[1::2], [PSFS[5]]), ids=lambda p: f"{p.model}-{p.edge}")
def test_what_is_nearer_hides_what_is_farther(psf: Psf, method: str) -> None:
    """A disc of -4 px before the waves, with layers; a map without jumps is as without them."""
    image, coc = picture(60, 80, channels=3)
    model = psf.model_copy(update={"occlusion": "layered"})
    black: Any = {"method": method, "outside": "black"}
    assert np.array_equal(defocus(image, coc, model, **black), apart(image, coc, psf, method))
    i, j = np.mgrid[0:60, 0:80]
    disc = np.hypot(i - 28, j - 33) < 15
    image, coc = np.where(disc[..., None], 0.2 * image, image), np.where(disc, -4.0, 1.0 + 0.6 * np.abs(coc))
    found = defocus(image, coc, model, **black)
    light, largest = np.asarray(image, np.float64), float(np.abs(coc).max())
    expected, count = layered_before_black(spec_of(model, largest), light, coc)
    assert count == 2
    assert np.abs(expected - reference(image, coc, psf)).max() > 0.1
    assert np.abs(found - expected).max() < FIGURE


@pytest.mark.parametrize("method", ["convolve", "gather"])
@pytest.mark.parametrize("radius", mostly_slow([5.0, 20.0, 60.0], [60.0]))
def test_a_wide_blur_leaves_a_uniform_image_as_it_is(radius: float, method: str) -> None:
    """Eleven thousand equal taps: added one by one to a float they would leave 6.6e-5."""
    side, reach = int(2 * radius + 40), int(radius + 3)
    coc = np.full((side, side), radius)
    if method == "gather":  # far from the middle: another radius, so that this is no convolution
        coc[0, 0] = radius - 0.1
    image = defocus(np.full((side, side), 0.73, dtype=np.float32), coc, Psf(tilt=False))
    inside = image[reach + 2 : -reach, reach + 2 : -reach]
    assert inside.size
    assert np.abs(inside / 0.73 - 1.0).max() < 1.2e-6


@pytest.mark.parametrize(
    "psf", mostly_slow([{}, {"occlusion": "none", "model": "gaussian"}, {"border": "renormalize"}], [{}]), ids=str
)
def test_arrays_are_blurred_as_the_files_of_the_command(psf: dict[str, Any]) -> None:
    """A scene of one depth map: layered, and lit by its mirror image; radii come back rounded."""
    rows, columns = 50, 40
    image, _ = picture(rows, columns, 3)
    coc = np.where(np.hypot(*np.ogrid[-20:30, -20:20]) < 12, -4.1, 1.03 + 0.02 * np.arange(columns))
    item = {"shape": "depth_map", "texture": image, "depth": coc, "unit": "coc"}
    camera = {"focus_distance": 250.0, "pixel_pitch": 0.02, "resolution": (columns, rows)}
    frame = clsco.render_frame(clsco.parse_scene({"camera": camera, "psf": psf, "object": [item]}), truth=())
    np.testing.assert_allclose(defocus(image, coc, psf), frame.color, rtol=1e-6)


def test_uniform_light_stays_uniform_up_to_the_border() -> None:
    image, coc = np.full((40, 50), 0.5, np.float32), np.full((40, 50), 6.0)
    np.testing.assert_allclose(defocus(image, coc), 0.5, rtol=1e-6)
    coc[:, 20:] = 0.0  # what is in focus, behind a near half
    np.testing.assert_allclose(defocus(image, coc), 0.5, rtol=1e-5)
    dark = defocus(image, np.full(coc.shape, 12.0), outside="black")
    assert 0.125 < dark[0, 0] < 0.15  # a quarter of its light, and of half a pixel more
    with pytest.raises(ClscoError, match='outside: must be "mirror" or "black"; got \'zero\''):
        defocus(image, coc, outside="zero")  # type: ignore[call-overload]
    for psf, cells in ((None, 3), ({"border": "renormalize"}, 2)):
        with pytest.raises(ClscoError, match=f"cells: must be 1 or 2, and 1 with .*; got {cells}"):
            defocus(image, coc, psf, cells=cells)


def test_a_blurred_background_does_not_bleed_into_what_is_in_focus() -> None:
    coc = np.where(np.arange(64) < 32, 0.0, 8.0) * np.ones((48, 1))
    image = np.where(coc > 0, 1.0, 0.0).astype(np.float32)
    assert defocus(image, coc)[:, :31].max() < 1e-6
    assert apart(image, coc)[10:-10, 30].min() > 0.3


def test_renormalized_border_loses_no_light() -> None:
    image, coc = picture(50, 60)
    psf = Psf(border="renormalize", occlusion="none")
    result = defocus(image, coc, psf)
    # float32 sums of 3000 pixels: 1e-6 of the total is ten times their rounding
    assert result.sum(dtype=np.float64) == pytest.approx(image.sum(dtype=np.float64), rel=1e-6)
    assert np.abs(result - reference(image, coc, psf)).max() < FIGURE
    lost = apart(image, coc).sum(dtype=np.float64)
    assert lost < 0.99 * image.sum(dtype=np.float64)


def test_in_focus_is_the_image_itself() -> None:
    image, _ = picture(20, 30)
    assert np.array_equal(defocus(image, np.zeros(image.shape)), image)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (17, 1), (2, 3), (33, 65)])
def test_small_and_odd_sizes(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(1).random(shape, dtype=np.float32)
    coc = np.linspace(-3.0, 4.0, image.size).reshape(shape)
    assert np.abs(apart(image, coc) - reference(image, coc, Psf())).max() < FIGURE


def test_device_arrays_come_back_as_device_arrays(session: Session) -> None:
    image, coc = picture(30, 40)
    on_device = cl_array.to_device(session.queue, image)
    result = defocus(on_device, cl_array.to_device(session.queue, coc.astype(np.float32)))
    assert isinstance(result, cl_array.Array)
    assert np.array_equal(result.get(), defocus(image, coc.astype(np.float32)))


def test_the_same_bits_every_time() -> None:
    image, coc = picture(64, 64)
    for method in ("gather", "scatter"):
        assert len({defocus(image, coc, method=method).tobytes() for _ in range(3)}) == 1


@pytest.mark.parametrize("method", mostly_slow(["gather", "scatter", "tiles", "convolve"], ["gather", "convolve"]))
@pytest.mark.parametrize("brightest", [0.0, 1e-36])
def test_hardly_any_light_is_hardly_any_light(method: str, brightest: float) -> None:
    image, coc = picture(12, 9)
    radii = np.full_like(coc, 1.5) if method == "convolve" else coc
    found = defocus(image * np.float32(brightest), radii, method=method)
    assert np.abs(found).max() <= 1.001 * brightest * image.max()


def test_arrays_may_lie_in_memory_in_any_order() -> None:
    image, coc = picture(9, 14)
    expected = defocus(image, coc)
    turned = defocus(np.asfortranarray(image), np.asfortranarray(coc))
    np.testing.assert_array_equal(turned, expected)
    np.testing.assert_array_equal(defocus(image[::-1][::-1], np.repeat(coc, 2, axis=1)[:, ::2]), expected)


ONES = np.ones((4, 5), np.float32)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((ONES, np.ones((5, 4))), "blur_radius: must have the rows and columns of the image, (4, 5); got (5, 4)"),
        ((ONES[0], np.ones(5)), "image: must have the shape"),
        ((ONES, np.full((4, 5), np.nan)), "blur_radius: must be finite, and at most 1e+36 in size; got 20 others"),
        ((np.full((4, 5), 2e36, np.float32), ONES), "image: must be finite, and at most 1e+36 in size; got 20 others"),
        ((np.ones((4, 5), np.int32), ONES), "image: must be floats, uint8 or uint16; got int32"),
        ((ONES, np.full((4, 5), 1e4)), "blur_radius: must be at most 512 px; got 1e+04 px"),
        ((ONES, ONES, {"edge": "sharp"}), "psf.edge"),
        ((ONES, ONES, {"sigma_ratio": 1.0}), "psf.sigma_ratio"),
        ((ONES, ONES, {"occlusion": "visibility"}), 'psf.occlusion: "visibility" needs analytic surfaces'),
    ],
)
def test_what_is_refused(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ClscoError) as caught:
        defocus(*arguments)
    assert message in str(caught.value)


@pytest.mark.parametrize("method", ["convolve", "fast"])
def test_unknown_or_unfit_methods_are_refused(method: str) -> None:
    image, coc = picture(8, 8)
    with pytest.raises(ClscoError, match="method: "):
        defocus(image, coc, method=method)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", mostly_slow([2, 4], [2]))
def test_alpha_of_codes_is_linear(dtype: type[np.unsignedinteger[Any]], channels: int) -> None:
    """That of a constant stays, that of 0 and 136 becomes 68, whatever the light; colors are as without it."""
    top = np.iinfo(dtype).max
    image = np.zeros((64, 48, channels), dtype)
    image[..., -1] = 68 * (top // 255)
    image[:, ::2, :-1] = top
    image[32:, ::2, -1], image[32:, 1::2, -1] = 136 * (top // 255), 0
    radius, aperture = np.full((64, 48), 6.0), {"shape": "polygon", "blades": 5, "exposure": "area"}
    blurred = clsco.defocus(image, radius, aperture=aperture)
    np.testing.assert_allclose(blurred[:12, ..., -1], 68 * (top // 255), atol=1)
    np.testing.assert_allclose(blurred[-12:, 8:-8, -1] / top, 68 / 255, atol=0.02)
    alone = clsco.defocus(image[..., :-1], radius, aperture=aperture)
    np.testing.assert_allclose(blurred[..., :-1].astype(int), alone, atol=1)
    assert blurred[..., 0].max() < 0.72 * top  # 0.74 of white has half the light, less what five blades hold back


def images(rows: int, columns: int) -> list[tuple[Any, Any]]:
    """A partly clear foreground with a step of radius, and two walls, the nearer one with a hole."""
    i, j = np.mgrid[0:rows, 0:columns]
    rng, veil = np.random.default_rng(8), np.clip((14 - np.hypot(i - rows / 2, j - columns / 2)) / 6, 0, 1)
    alphas = veil, (np.hypot(i - 9, j - 12) > 6) * 1.0, np.ones(i.shape)
    radii = np.where(j < columns / 2, -4.0, -1.5), np.full(i.shape, 1.8), 3.0 + 0.01 * j
    layers = []
    for alpha, coc in zip(alphas, radii, strict=True):
        image = np.dstack([rng.random((rows, columns, 3)) * alpha[..., None], alpha])
        layers.append((image.astype(np.float32), coc))
    return layers


@pytest.mark.parametrize(("outside", "cells"), [("mirror", 1), ("black", 1), ("black", 2)])
def test_images_over_each_other(outside: Any, cells: int) -> None:
    layers, psf = images(40, 56), Psf()
    spec = spec_of(psf, 4.0, cells=cells)
    guard = guard_band(spec.psf, "lose", 4.0)
    mode: Any = {"mirror": "symmetric", "black": "constant"}[outside]
    padded = [
        (np.pad(image, ((guard, guard), (guard, guard), (0, 0)), mode).astype(np.float64), np.pad(coc, guard, mode))
        for image, coc in layers
    ]
    expected = over(spec, padded, (40, 56), guard)
    blurred = defocus(layers=layers, psf=psf, outside=outside, cells=cells)
    assert np.abs(blurred - expected).max() < FIGURE
    assert np.array_equal(defocus(layers=layers[::-1], psf=psf, outside=outside, cells=cells), blurred)
    if outside == "mirror":
        np.testing.assert_allclose(blurred[..., 3], 1.0, rtol=0, atol=1e-6)


@pytest.mark.parametrize("cells", [1, 2])
def test_an_opaque_image_hides_what_is_behind_and_parts_of_one_surface_join(cells: int) -> None:
    image, _ = picture(40, 56, channels=3)
    i, j = np.mgrid[0:40, 0:56]
    coc = np.where(np.hypot(i - 18, j - 30) < 11, -3.0, 2.0)
    whole = np.dstack([image, np.ones(coc.shape)]).astype(np.float32), coc
    plain, opaque = defocus(whole[0][..., :3], coc, cells=cells), defocus(layers=[whole], cells=cells)
    np.testing.assert_allclose(opaque[..., :3], plain, rtol=0, atol=1e-6)
    farther = defocus(layers=[whole, (whole[0] * np.float32(0.5), coc + 4.0)], cells=cells)
    np.testing.assert_allclose(farther[..., :3], opaque[..., :3], rtol=0, atol=1e-6)
    mask = (np.random.default_rng(2).random(coc.shape) < 0.5)[..., None]
    parts = defocus(layers=[(whole[0] * mask, coc), (whole[0] * ~mask, coc)], cells=cells)
    assert np.array_equal(parts, opaque)


def test_what_is_not_seen_has_no_effect_and_highlights_leave_no_dark_pixels() -> None:
    layers = images(24, 32)
    blurred = defocus(layers=layers)
    clear = np.zeros_like(layers[0][0]), np.full((24, 32), np.nan)
    assert np.array_equal(defocus(layers=[*layers, clear]), blurred)
    far = [(image, np.where(image[..., -1] > 0, coc, 1e9)) for image, coc in layers]
    assert np.array_equal(defocus(layers=far), blurred)
    bright, coc = np.full((24, 24), 0.5), np.where(np.arange(24) < 12, -3.0, 5.0)[None].repeat(24, 0)
    bright[10, 10] = 1e6
    assert defocus(bright, coc).min() >= 0.5 * (1 - 1e-6)
    np.testing.assert_allclose(defocus(np.full((24, 24), 1e36), coc), 1e36, rtol=1e-6)


def test_wrong_layers_are_named() -> None:
    (image, coc), *_ = images(8, 9)
    wrong: list[tuple[Any, str]] = [
        ([(image, coc)] * 9, "layers: must be at most 8; got 9"),
        ([(image, coc), (image[:4], coc[:4])], r"layers\[1\]: image: must have the shape \(8, 9, 4\) of the first one"),
        ([(image, coc), (image, coc[:4])], r"layers\[1\]: blur_radius: must have the rows and columns of the image"),
        ([(2 * image, coc)], r"layers\[0\]: image: alpha must be from 0 to 1; got 2"),
        ([(image[..., :1], coc)], r"layers\[0\]: image: must have alpha; got \(8, 9, 1\)"),
        (np.stack([image] * 2), "layers: must be a list of pairs; got ndarray"),
        ((image, coc), "layers: must be pairs of an image and its blur radii; got something else"),
        ([], "layers: must be given in place of image and blur_radius; got both or none of them"),
    ]
    for layers, text in wrong:
        with pytest.raises(clsco.ArgumentError, match=text):
            defocus(layers=layers)
    with pytest.raises(clsco.SceneError, match=r'psf\.occlusion: must be "layered" for layers; got "none"'):
        defocus(layers=[(image, coc)], psf={"occlusion": "none"})
