"""Meaning of the numbers of depth maps in each unit, and one line where they cannot be meant."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from clsco.errors import FileError
from clsco.inputs.depth_maps import FARTHEST, DepthValues, fill_depth, inverse_depth, map_values
from clsco.optics.lens import LARGEST_BLUR, Lens, blur_radius
from clsco.scene.model import Camera, DepthMap
from tests.scenes import scene_of

Array = NDArray[Any]
CAMERA = Camera()  # kappa = 10,000 px mm, in focus at 250.017 mm, 39.997 px at infinity
BASELINE = 60.0
UNITS = get_args(DepthMap.model_fields["unit"].annotation)


def values_of(raw: Any, unit: Any, camera: Camera = CAMERA, where: str = "depth", **keys: Any) -> DepthValues:
    item = DepthMap(depth="z.npy", unit=unit, **({"baseline": BASELINE} if unit == "disparity" else {}) | keys)
    return inverse_depth(np.atleast_2d(raw), item, camera, where)


def w_of(raw: Any, unit: str, **options: Any) -> Array:
    return values_of(raw, unit, **options).inverse_depth[0]


@pytest.mark.parametrize(("unit", "value", "meters"), [
    ("mm", 320.0, Fraction(32, 100)),
    ("m", 0.75, Fraction(3, 4)),
    ("inverse_mm", 2.0**-8, Fraction(256, 1000)),
    ("inverse_m", 4.0, Fraction(1, 4)),
    # Z = B s0 / (p d) = 60 mm * 20 mm / (0.01 mm * 480)
    ("disparity", 480.0, Fraction(1, 4)),
])  # fmt: skip
def test_units_against_exact_fractions(unit: str, value: float, meters: Fraction) -> None:
    expected = float(1 / (1000 * meters))
    # Three roundings at most, of the product with the scale, of a factor and of the division: 2^-53 each.
    np.testing.assert_allclose(w_of([value], unit), [expected], rtol=3 * 2.0**-53)
    np.testing.assert_allclose(w_of([value * 256], unit, scale=1 / 256), [expected], rtol=3 * 2.0**-53)


NAN, INF = np.nan, np.inf
RANGE = {"near": 250.0, "far": 1000.0}


@pytest.mark.parametrize(("unit", "keys", "raw", "millimeters"), [
    # Z = B s0 / (p d) = 60 mm * 20 mm / (0.01 mm * d), where 0 is no depth, and what is no number or unknown.
    ("disparity", {"offset": 120.0}, [360.0, 0.0, -60.0, -120.0, -121.0, NAN, INF], [250, 1000, 2000, 0, 0, 0, 0]),
    ("disparity", {"offset": 120.0, "scale": 2.0}, [180.0], [250]),
    ("disparity", {"offset": 120.0}, np.array([360, 0], np.uint16), [250, 0]),
    ("disparity", {"offset": 600.0, "scale": -1.0}, [120.0, 0.0, 600.0, -INF, INF], [250, 200, 0, 0, 0]),
    ("disparity", {"scale": -1 / 16}, np.array([-7680, 7680, 0], np.int16), [250, 0, 0]),
    ("inverse_m", {"offset": 1.0, "scale": 0.5}, [6.0, 0.0, -2.0, -3.0, INF, NAN], [250, 1000, INF, 0, 0, 0]),
    ("inverse_mm", {"offset": 1e-3, "scale": 1e-3}, np.array([3, 0], np.uint8), [250, 1000]),
    ("inverse_m", RANGE, np.array([255, 0, 51], np.uint8), [250, 1000, 625]),
    ("inverse_mm", RANGE, [7.0, -1.0, NAN, INF, -INF], [250, 1000, 0, 0, 0]),
    ("inverse_m", {"near": 250.0}, [1.0, 0.5, 0.0], [250, 500, INF]),
    ("inverse_m", RANGE | {"scale": -1.0}, [0.0, 1.0], [250, 1000]),
    ("mm", RANGE, np.array([0, 65535, 13107], np.uint16), [250, 1000, 400]),
    ("m", RANGE, [-1.0, 1.0, 0.0, NAN, INF, -INF], [250, 1000, 625, 0, INF, 0]),
    ("mm", {}, np.array([0, 250, 65535], np.uint16), [0, 250, 65535]),
    ("mm", {"offset": 4.25}, np.array([0, 250], np.uint16), [0, 254.25]),
    ("mm", {"offset": 100.0}, [0.0, 150.0, -100.0, -101.0, INF], [100, 250, 0, 0, INF]),
    ("m", {"scale": 1 / 256}, np.array([0, 256, 65535], np.uint16), [0, 1000, 65535000 / 256]),
    ("m", {"scale": -1.0}, [-0.25, 0.25, -INF, INF], [250, 0, INF, 0]),
])  # fmt: skip
def test_what_numbers_mean_after_scale_and_offset(
    unit: str, keys: dict[str, float], raw: Any, millimeters: list[float]
) -> None:
    inverse = [0 if z == 0 else FARTHEST if z == INF else 1 / z for z in millimeters]
    np.testing.assert_allclose(w_of(raw, unit, **keys), inverse, rtol=1e-14)


def test_a_radius_of_the_other_sign_and_focus() -> None:
    shifted = blur_radius(CAMERA, w_of(np.array([0, 3, -4], np.int8), "coc", scale=-1.0, offset=2.0))
    np.testing.assert_allclose(shifted, [2.0, -1.0, 6.0], atol=1e-12)


@pytest.mark.parametrize("unit", UNITS)
def test_numbers_of_the_other_sign_are_the_same_map(unit: str) -> None:
    """Soft edges and pixels without a depth among them."""
    step = np.interp(np.arange(24), [10, 14], [GOOD[unit], 1.5 * GOOD[unit]]).astype(np.float32)
    raw = np.tile(step, (12, 1))
    raw[3:6, 2:5] = np.nan
    keys: dict[str, Any] = {"unit": unit, **({"baseline": BASELINE} if unit == "disparity" else {})}
    one, other = map_of(raw, **keys), map_of(-raw, scale=-1.0, **keys)
    np.testing.assert_array_equal(one.inverse_depth, other.inverse_depth)
    assert one.report() == other.report() != ""


def test_the_page_of_depth_maps_lists_every_unit() -> None:
    page = Path("docs/depth_maps.md").read_text()
    rows = [line.split("|")[1] for line in page.partition("| `unit` |")[2].partition("\n\n")[0].splitlines()[2:]]
    assert [unit for row in rows for unit in row.replace("`", "").replace(",", " ").split()] == list(UNITS)


def test_a_radius_is_taken_as_it_is() -> None:
    radii = [-30.0, 0.0, 12.5, 39.0]
    # K - w cancels: both are at most 0.007 per mm, each rounded twice to 2^-53 of that, and kappa makes px of it.
    bound = 4 * 2.0**-53 * 0.007 * Lens.of(CAMERA).blur_scale
    assert blur_radius(CAMERA, w_of(radii, "coc")) == pytest.approx(radii, abs=bound)
    assert blur_radius(CAMERA, w_of(radii, "coc", scale=0.5)) == pytest.approx([-15, 0, 6.25, 19.5], abs=bound)


def test_infinity_as_a_radius_is_infinitely_far() -> None:
    at_infinity = np.float32(blur_radius(CAMERA, 0.0))  # as a file of floats has it, a little beyond or short of it
    beyond = float(np.nextafter(at_infinity, np.float32(np.inf)))
    values = values_of([beyond, 0.0], "coc")
    assert values.inverse_depth[0, 0] == FARTHEST
    assert (values.far, values.invalid) == (1, 0)


KINDS = [0.0, -0.0, -1.0, -np.inf, np.nan, np.inf]
GOOD = {"mm": 250.0, "m": 0.25, "inverse_mm": 0.004, "inverse_m": 4.0, "disparity": 480.0, "coc": 3.0}


@pytest.mark.parametrize(("unit", "zero", "negative", "nan", "infinite", "far"), [
    ("mm", 2, 2, 1, 0, 1),
    ("m", 2, 2, 1, 0, 1),
    ("inverse_mm", 0, 2, 1, 1, 2),
    ("inverse_m", 0, 2, 1, 1, 2),
    ("disparity", 2, 2, 1, 1, 0),
    ("coc", 0, 0, 1, 2, 0),
])  # fmt: skip
def test_what_each_kind_of_number_means(unit: str, zero: int, negative: int, nan: int, infinite: int, far: int) -> None:
    raw = np.array([[GOOD[unit], *KINDS]])
    values = values_of(raw, unit)
    assert values.missing == {"zero": zero, "negative": negative, "NaN": nan, "infinite": infinite}
    assert values.far == far
    w = values.inverse_depth[0]
    assert w[0] > FARTHEST
    assert (w == FARTHEST).sum() == far
    assert (w == 0).sum() == values.invalid == zero + negative + nan + infinite
    assert (w >= 0).all()
    assert np.isfinite(w).all()
    assert values.inverse_depth.shape == raw.shape


def test_report_tells_the_kinds_that_there_are() -> None:
    raw = np.array([[250.0, 0.0, 0.0, np.nan], [250.0, np.inf, -3.0, 1e10]])
    recorded = "4 of 8 pixels have no depth (2 zero, 1 negative, 1 NaN), 1 is infinitely far"
    assert values_of(raw, "mm").report() == recorded
    assert values_of(np.full((2, 2), 250.0), "mm").report() == ""
    assert values_of([250.0, np.inf], "mm").report() == "1 of 2 pixels is infinitely far"
    disparity = values_of([480.0, np.inf], "disparity")
    assert disparity.report() == "1 of 2 pixels have no depth (1 infinite)"


def test_the_background_of_a_renderer_is_there() -> None:
    values = values_of([0.3, 1e10, 1e9, 65504.0], "m")
    np.testing.assert_array_equal(values.inverse_depth[0, 1:3], FARTHEST)
    assert (values.invalid, values.far) == (0, 2)
    # 1e-12 per mm is 1e-8 px from infinity with kappa = 1e4 px mm.
    assert blur_radius(CAMERA, values.inverse_depth[0, 1]) == pytest.approx(float(blur_radius(CAMERA, 0.0)), abs=1e-7)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("seed", range(16))
def test_every_unit_tells_the_same_depth(unit: str, seed: int) -> None:
    ranges = np.array([[20.0, 1e9], [1e-4, 1e4], [10.0, 100.0], [2.0, 1e4], [1.0, 1e3]])
    millimeters, scale, focal, focus, baseline = np.exp(np.random.default_rng(seed).uniform(*np.log(ranges.T)))
    camera = Camera(focal_length=focal, focus_distance=focal * focus, aperture_diameter=0.1, pixel_pitch=0.01)
    expected = 1 / millimeters
    value = {
        "mm": millimeters,
        "m": millimeters / 1000,
        "inverse_mm": expected,
        "inverse_m": 1000 * expected,
        "disparity": baseline * camera.normalization_distance / (camera.pixel_pitch * millimeters),
        "coc": float(blur_radius(camera, expected)),
    }[unit]
    keys: dict[str, Any] = {"baseline": baseline} if unit == "disparity" else {}
    values = values_of([value / scale], unit, camera, scale=scale, **keys)
    # Eight roundings of 2^-53 at most; of a radius, each is relative to the larger of K and w instead.
    size = max(expected, abs(Lens.of(camera).focus_power), 1 / focal) if unit == "coc" else expected
    assert values.inverse_depth[0, 0] == pytest.approx(expected, rel=0, abs=8 * 2.0**-53 * size)
    assert values.invalid == 0


def fault(raw: list[float], unit: str, **options: Any) -> str:
    with pytest.raises(FileError) as caught:
        w_of(raw, unit, **options)
    return str(caught.value)


METERS = [0.2, 0.25, 5.0, 0.0]
LARGE = "depth: the blur radius must be at most 512 px; got "
AT_INFINITY = "px, which the camera has at infinity"


IN = "the depth is probably in {0}: give unit {0}".format
OR = "{}; or where larger numbers are nearer, {} with a scale below {}".format
EITHER = "; or where larger numbers are nearer, inverse_m"
NO_UNIT = "no unit makes it less: scale, or the camera, is probably wrong"


@pytest.mark.parametrize(("raw", "unit", "got", "pixels", "cause"), [
    (METERS, "mm", "4.996e+04 px at 0.2 mm", "3 of 3", IN("m") + EITHER),
    ([0.8, 3.0], "mm", "1.246e+04 px at 0.8 mm", "2 of 2", IN("m") + EITHER),
    ([200.0, 5000.0], "inverse_m", "4.996e+04 px at 5000 inverse_m", "2 of 2", OR(IN("mm"), "inverse_m", 0.011)),
    ([200.0, 5000.0], "inverse_mm", "5e+07 px at 5000 inverse_mm", "2 of 2", OR(IN("mm"), "inverse_mm", "1.1e-05")),
    ([0.0, 300.0], "inverse_mm", "3e+06 px at 300 inverse_mm", "1 of 2", OR(IN("mm"), "inverse_mm", 0.00018)),
    ([0.003, 0.005], "mm", "3.333e+06 px at 0.003 mm", "2 of 2", IN("inverse_mm")),
    ([300.0, 5000.0], "coc", "5000 px at 5000 coc", "1 of 2", IN("mm")),
    ([-2000.0, 500.0], "coc", "2000 px at -2000 coc", "1 of 2", NO_UNIT),
    ([1.0, 1e6], "disparity", "8.329e+04 px at 1e+06 disparity", "1 of 2", IN("m")),
    ([250.0, 1e-9], "mm", "1e+13 px at 1e-09 mm", "1 of 2", NO_UNIT),
    ([250.0, 1e-320], "mm", "inf px at 1e-320 mm", "1 of 2", NO_UNIT),
])  # fmt: skip
def test_radii_of_thousands_of_pixels_name_the_likely_unit(
    raw: list[float], unit: str, got: str, pixels: str, cause: str
) -> None:
    assert fault(raw, unit) == f"{LARGE}{got}, and more than that limit in {pixels} pixels ({cause})"


def test_a_camera_of_thousands_of_pixels_is_named() -> None:
    message = fault([250.0, 1e5], "mm", camera=Camera(aperture_diameter=1000.0))
    assert message == (
        f"{LARGE}3990 px at 1e+05 mm, and more than that limit in 1 of 2 pixels (the camera has 4000 px at infinity: "
        "aperture_diameter or pixel_pitch is probably wrong)"
    )
    w_of([250.0, 260.0], "mm", camera=Camera(aperture_diameter=1000.0))  # as long as no surface is that far


def test_the_limit_is_the_one_of_the_renderer() -> None:
    nearest = 1 / (Lens.of(CAMERA).focus_power + LARGEST_BLUR / Lens.of(CAMERA).blur_scale)
    w_of([nearest * (1 + 1e-9)], "mm")
    assert fault([nearest * (1 - 1e-9)], "mm").startswith(LARGE)


@pytest.mark.parametrize(("raw", "unit", "options", "message"), [
    ([0.0, np.nan, -2.0], "mm", {}, "depth: at least one pixel must have a depth; got 1 zero, 1 negative, 1 nan"),
    ([np.inf], "disparity", {}, "depth: at least one pixel must have a depth; got 1 infinite"),
    ([3.0, 3.0, np.nan], "m", RANGE, "depth: near and far need numbers that differ; got 3 alone"),
    ([0.0, 3.0], "inverse_m", {"near": 0.3}, f"{LARGE}3.329e+04 px at 3.333 inverse_mm, and more than that limit in 1"),
    ([45.0, 60.0, 3.0], "coc", {},
     f"depth: radii must be at most 39.9972 {AT_INFINITY}, or its aperture_diameter at least 15.02 mm; got 60 px"),
    ([0.0], "coc", {"camera": Camera(sensor_distance=19.0)},
     f"depth: radii must be at most -26.3158 {AT_INFINITY}; got 0 px, and 1 pixels above the limit"),
    ([2e-7], "mm", {"camera": Camera(aperture_diameter=1e-6, pixel_pitch=1.0)},
     "depth: depth must be at least 1e-06 mm; got 2e-07 mm"),
    ([0.25], "mm", {"where": "room.exr"}, "room.exr: the blur radius must be at most 512 px"),
])  # fmt: skip
def test_every_other_refusal(raw: list[float], unit: str, options: dict[str, Any], message: str) -> None:
    assert fault(raw, unit, **options).startswith(message)


def test_the_aperture_that_is_suggested_will_do() -> None:
    w_of([45.0, 60.0, 3.0], "coc", camera=Camera(aperture_diameter=15.02))


def test_missing_depths_of_a_plane_come_back() -> None:
    row, column = np.indices((40, 50))
    w = 1e-3 * (3 + 0.01 * row - 0.005 * column)  # a tilted plane: 1/Z is linear in the image
    holes = np.random.default_rng(6).random(w.shape) < 0.6
    holes[10:25, 12:30] = True
    holes[[0, -1], :], holes[:, [0, -1]] = False, False  # beyond the outermost depths nothing is known of a slope
    filled = fill_depth(np.where(holes, 0.0, w))
    # Over gaps of up to 20 px in rows and columns w changes by less than 0.2 of 2.75, which may be one surface.
    np.testing.assert_allclose(filled, w, rtol=1e-13)
    assert (filled[~holes] == w[~holes]).all()


def test_missing_depths_at_a_step_are_the_farther_ones() -> None:
    w = np.full((6, 12), 1 / 200)
    w[:, 6:] = 1 / 400
    known = w.copy()
    known[:, 3:9] = 0.0
    assert (fill_depth(known)[:, 3:9] == 1 / 400).all()
    assert (fill_depth(known.T)[3:9] == 1 / 400).all()


def test_missing_depths_are_those_of_one_of_two_surfaces() -> None:
    w = np.full((9, 40), 1 / 200)
    w[:, 20:] = 1 / 400
    known = w.copy()
    known[4, 2:38] = 0.0  # a line that crosses the step: what is above and below is closest
    np.testing.assert_allclose(fill_depth(known), w, rtol=1e-15)
    known = w.copy()
    known[2:7, 18:23] = 0.0  # as far to both sides as up and down
    np.testing.assert_allclose(fill_depth(known)[2:7, 18:23], 1 / 400, rtol=1e-15)


def test_a_single_depth_fills_the_map() -> None:
    w = np.zeros((5, 7))
    w[1, 5] = 1 / 300
    np.testing.assert_allclose(fill_depth(w), 1 / 300, rtol=1e-15)
    assert (fill_depth(np.zeros((2, 3))) == 0.0).all()


def test_8_bits_of_relative_inverse_depth_are_not_taken_for_meters() -> None:
    message = fault([1.0, 2.0, 128.0, 255.0], "mm")
    assert message.endswith(f"({OR(IN('m'), 'inverse_m', 0.22)})")
    w_of([1.0, 2.0, 128.0, 255.0], "inverse_m", scale=0.2)
    limit = 1000 * (Lens.of(CAMERA).focus_power + LARGEST_BLUR / Lens.of(CAMERA).blur_scale) / 255
    assert limit == pytest.approx(0.22, abs=0.005)
    assert fault([2.0, 510.0], "mm", scale=0.5).endswith(f"({OR(IN('m'), 'inverse_m', 0.11)})")


WIDE = Camera(focal_length=24.0, pixel_pitch=0.36)  # 100 columns see 74 degrees


@pytest.mark.parametrize(("unit", "number"), [
    ("mm", lambda z: z), ("m", lambda z: z / 1e3), ("inverse_mm", lambda z: 1 / z), ("inverse_m", lambda z: 1e3 / z),
])  # fmt: skip
def test_distances_along_rays_become_depths(unit: str, number: Any) -> None:
    """A wall at 300 mm is farther along the rays of its corners."""
    y, x = np.indices((67, 100)) - np.array([33.0, 49.5])[:, None, None]
    distance = 300.0 * np.sqrt(1.0 + (x**2 + y**2) * (0.36 / 24.0) ** 2)
    assert distance[0, 0] / 300 == pytest.approx(1.34, abs=0.01)
    values = values_of(number(distance), unit, WIDE, depth_kind="ray")
    np.testing.assert_allclose(values.inverse_depth, 1 / 300, rtol=1e-14)
    planar = values_of(number(distance), unit, WIDE)
    # 24 mm at f/2.4 and this pitch have kappa = 333 px mm: the corner would be blurred by another 0.28 px.
    off = blur_radius(WIDE, planar.inverse_depth) - blur_radius(WIDE, values.inverse_depth)
    assert off[0, 0] == pytest.approx(Lens.of(WIDE).blur_scale * (1 / 300 - 1 / distance[0, 0]), rel=1e-9)


def test_infinity_along_a_ray_and_no_depth_stay_what_they_are() -> None:
    values = values_of([np.inf, 0.0, np.nan, 300.0], "mm", WIDE, depth_kind="ray")
    np.testing.assert_array_equal(values.inverse_depth[0, :3], [FARTHEST, 0.0, 0.0])
    assert (values.far, values.missing["zero"], values.missing["NaN"]) == (1, 1, 1)


def map_of(raw: Any, camera: dict[str, Any] | None = None, **keys: Any) -> DepthValues:
    depth = np.array(raw)
    scene = scene_of(DepthMap(texture="bricks", depth=depth, **keys), size=depth.T.shape, camera=camera)
    (item,) = scene.objects
    assert isinstance(item, DepthMap)
    return map_values(scene, item, depth)


def test_the_sky_is_far_where_it_is_said() -> None:
    """A figure before pixels without a depth: these would be at its depth, and as sharp."""
    raw = [[0.0, np.nan, -1.0, 0.0], [0.0, 250.0, 250.0, 0.0]]
    around, far = map_of(raw), map_of(raw, no_depth="far")
    np.testing.assert_array_equal(around.inverse_depth, 1 / 250)
    np.testing.assert_array_equal(far.inverse_depth, [[FARTHEST] * 4, [FARTHEST, 1 / 250, 1 / 250, FARTHEST]])
    assert around.report() == far.report() == "6 of 8 pixels have no depth (4 zero, 1 negative, 1 NaN)"
    sky = map_of([[0.0, np.nan]], no_depth="far")
    assert (sky.inverse_depth == FARTHEST).all()
    assert sky.report() == "2 of 2 pixels have no depth (1 zero, 1 NaN)"
    whole = map_of([[250.0, 300.0]], no_depth="far")
    np.testing.assert_array_equal(whole.inverse_depth, map_of([[250.0, 300.0]]).inverse_depth)


def test_a_sky_that_is_blurred_too_much_is_refused() -> None:
    camera = {"focal_length": 50.0, "f_number": 0.5, "pixel_pitch": 0.005, "focus_distance": 250.0}
    map_of([[0.0, 250.0]], camera)
    with pytest.raises(FileError, match=r"at most 512 px; got 2000 px at infinity, where no_depth puts 1 pixels"):
        map_of([[0.0, 250.0]], camera, no_depth="far")
