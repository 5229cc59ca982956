"""The thin lens against the thesis' equations and exact arithmetic."""

from __future__ import annotations

from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest

import clsco
from clsco.optics.lens import Lens, blur_radius, ray_step
from clsco.optics.point_spread import diffraction_unit
from clsco.scene.model import Camera

EPS = np.finfo(np.float64).eps
LENSES = [
    Camera(),
    Camera(focal_length=400.0, aperture_diameter=140.0, focus_distance=5000.0, pixel_pitch=0.005),
    Camera(focal_length=50.0, f_number=1.8, focus_distance=1500.0, pixel_pitch=0.004),
    Camera(focal_length=4.2, f_number=1.7, focus_distance=400.0, pixel_pitch=0.0014),
]


def exact_radius(camera: Camera, u: Fraction) -> Fraction:
    """R = (s0 D / 2 p) (1/f - 1/u - 1/s), 2.33 in pixels, in rational arithmetic."""
    keys = "focal_length", "sensor_distance", "aperture_diameter", "normalization_distance", "pixel_pitch"
    f, s, d, s0, p = (Fraction(float(getattr(camera, key))) for key in keys)
    return s0 * d / (2 * p) * (1 / f - 1 / u - 1 / s)


def thesis_radius(camera: Camera, u: float) -> float:
    """The same by 2.24 and 2.30, from where the image of a point at u lies; 2.32 scales s to s0."""
    v = 1.0 / (1.0 / camera.focal_length - 1.0 / u)
    s, d = camera.sensor_distance, camera.aperture_diameter
    r = d * (s - v) / v / 2.0
    return r * camera.normalization_distance / s / camera.pixel_pitch


@pytest.mark.parametrize("camera", LENSES, ids=lambda c: f"{c.focal_length:g} mm")
def test_radius_from_half_the_focus_distance_to_infinity(camera: Camera) -> None:
    near = 0.5 * camera.focused_distance
    for u in np.geomspace(near, 1e9, 200).tolist():
        # 1/u is rounded once: the figure to reach is 1e-4 px, and float64 stays a million times below it. K is
        # the difference of 1/f and 1/s, rounded by eps of those.
        w = 1.0 / u
        scale = Lens.of(camera).blur_scale * (1.0 / camera.focal_length + w)
        found = float(blur_radius(camera, w))
        assert abs(found - float(exact_radius(camera, Fraction(u)))) <= 4 * EPS * scale
        assert abs(found - float(exact_radius(camera, Fraction(u)))) < 1e-9
        assert found == pytest.approx(thesis_radius(camera, u), abs=16 * EPS * scale)


def test_the_thesis_camera_focuses_at_a_quarter_of_a_meter() -> None:
    camera = Camera()
    assert camera.focused_distance == pytest.approx(250.0172, abs=1e-4)  # 1 / (1/20 - 1/21.739) mm by hand
    assert Lens.of(camera).blur_scale == 20.0 * 10.0 / (2.0 * 0.01)
    assert float(blur_radius(camera, 1.0 / camera.focused_distance)) == pytest.approx(0.0, abs=1e-10)
    assert Camera(focal_length=50.0).focused_distance == pytest.approx(2.5 * camera.focused_distance)
    # "Blur at most about 6 px": at 292 mm, 10^4 (1/250.0172 - 1/292) = 5.75 px.
    assert float(blur_radius(camera, 1.0 / 292.0)) == pytest.approx(1e4 * (1 / 250.0172 - 1 / 292.0), abs=1e-4)


def test_focus_at_infinity() -> None:
    camera = Camera(sensor_distance=20.0)
    assert Lens.of(camera).focus_power == 0.0
    assert camera.focused_distance == np.inf
    assert Camera(sensor_distance=19.0).focused_distance == np.inf  # nearer than the focal length: nothing is sharp
    assert (blur_radius(camera, np.array([0.0, 0.01])) == [0.0, -Lens.of(camera).blur_scale * 0.01]).all()


@pytest.mark.parametrize("focus", [20.1, 250.0, 1e6])
def test_focus_distance_gives_the_detector_its_place(focus: float) -> None:
    camera = Camera(focus_distance=focus)
    # s = f u / (u - f); K = 1/f - 1/s loses the digits that u has over f.
    assert camera.focused_distance == focus
    given = Camera(sensor_distance=camera.sensor_distance)
    assert given.focus_distance is None
    assert given.focused_distance == pytest.approx(focus, rel=8 * EPS * focus / 20.0)
    assert camera.sensor_distance == pytest.approx(1.0 / (1.0 / 20.0 - 1.0 / focus), rel=8 * EPS * focus / (focus - 20))


def test_ray_step_is_the_pixel_seen_from_the_lens() -> None:
    assert ray_step(Camera()) == 0.01 / 20.0
    assert ray_step(Camera(normalization_distance=21.739)) == 0.01 / 21.739
    # 10 mm at 250 mm: 80 px (thesis, 4.3.3).
    assert 10.0 / 250.0 / ray_step(Camera()) == pytest.approx(80.0, rel=4 * EPS)


def squared_slope(camera: Camera, r: float) -> float:
    """Squared slope of the ray to a distance from the middle of the image, mm."""
    return (r / camera.normalization_distance) ** 2


def test_field_curvature_of_a_single_lens_at_the_corner_of_the_thesis_frame() -> None:
    # The Petzval radius of a thin lens of index 1.5 is -1.5 f; sag r^2 / 2 rho = 0.218 mm, about kappa sag / s^2 px.
    camera, corner = Camera(), float(np.hypot(2.555, 2.555))
    lens, plain = Lens.of(camera, clsco.Lens(field_curvature=-1.0 / 30.0)), Lens.of(camera)
    sag = corner**2 / 60.0
    assert sag == pytest.approx(0.218, abs=5e-4)
    change = float(lens.blur_radius(1 / 250.0, squared_slope(camera, corner)) - plain.blur_radius(1 / 250.0))
    assert change == pytest.approx(4.6, abs=0.05)  # nearer things are in focus there, as behind the focus R is positive
    assert change == pytest.approx(1e4 * (1 / 21.739 - 1 / (21.739 + sag)), rel=1e-12)
    assert float(lens.blur_radius(1 / 250.0)) == float(plain.blur_radius(1 / 250.0))


def test_a_sphere_in_focus_has_one_distance() -> None:
    camera = Camera(focus_distance=250.0)
    lens, tangent = Lens.of(camera, clsco.Lens(focus_surface="sphere")), np.array([0.0, 0.01, 0.1, 0.5, 1.0])
    depth = 250.0 / np.sqrt(1.0 + tangent**2)
    assert np.abs(lens.blur_radius(1.0 / depth, tangent**2)).max() < 1e-10
    plane = lens.blur_radius(1.0 / 250.0, tangent**2)
    np.testing.assert_allclose(plane, 1e4 * (1 / np.cos(np.arctan(tangent)) - 1.0) / 250.0, atol=1e-10)


def test_radii_are_those_of_rays_through_a_lens_with_a_sphere_in_focus() -> None:
    """Rays from the rim of the lens through the point of the sphere on the ray through its middle, up to a plane: the
    places that they meet, seen from the middle, are on a circle."""
    camera, depth = Camera(focus_distance=250.0, aperture_diameter=10.0), 320.0
    lens = Lens.of(camera, clsco.Lens(focus_surface="sphere"))
    turn = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    rim = 5.0 * np.stack([np.cos(turn), np.sin(turn), np.zeros(16)], axis=1)
    for slope in (0.0, 0.1, 0.5, 1.0):
        middle = np.array([0.6 * slope, 0.8 * slope, 1.0])
        focus = 250.0 * middle / np.sqrt(middle @ middle)
        met = rim + (focus - rim) * (depth / focus[2])
        away = (met / depth - middle)[:, :2] * camera.normalization_distance / camera.pixel_pitch
        np.testing.assert_allclose(np.hypot(*away.T), lens.blur_radius(1.0 / depth, slope * slope), rtol=1e-10)


def test_digits_where_the_radius_is_almost_zero() -> None:
    """Against exact arithmetic: what bends the focus adds no more error than the thin lens has."""
    camera = Camera()
    lens = Lens.of(camera, clsco.Lens(field_curvature=-1.0 / 30.0, focus_surface="sphere"))
    with localcontext() as context:
        context.prec = 60
        f, s, s0, t = Decimal(20), Decimal(camera.sensor_distance), Decimal(20), Decimal("0.2")
        bent = s - s0 * s0 * t * t * Decimal(-1.0 / 30.0) / 2
        in_focus = 1 / f - 1 / bent + (1 / f - 1 / s) * ((1 + t * t).sqrt() - 1)
        for change in (0.0, 1e-12, -1e-9, 1e-6):
            w = float(in_focus) * (1.0 + change)
            exact = float(Decimal(lens.blur_scale) * (in_focus - Decimal(w)))
            assert abs(float(lens.blur_radius(w, 0.2**2)) - exact) < 16 * EPS * lens.blur_scale / 20.0


def test_lines_f_and_c_differ_by_the_abbe_number() -> None:
    """1/f of F (486.1 nm) less that of C (656.3 nm) is 1 / (f V) of a single lens: 8.3 px for V = 60."""
    camera, number = Camera(), 60.0
    f = camera.focal_length
    axial = f / (1.0 - 0.5 / number) - f, 0.0, f / (1.0 + 0.5 / number) - f
    red, green, blue = (Lens.of(camera, clsco.Lens(axial=axial), color) for color in range(3))
    apart = float(blue.blur_radius(1 / 300.0) - red.blur_radius(1 / 300.0))
    assert apart == pytest.approx(1e4 / (20.0 * 60.0), rel=1e-12)
    assert round(apart, 1) == 8.3
    assert green == Lens.of(camera)
    assert {lens.blur_scale for lens in (red, green, blue)} == {1e4}
    assert {lens.radius for lens in (red, green, blue)} == {5.0}


def of_textbook(camera: Camera) -> Camera:
    return Camera.model_validate(camera.model_dump(exclude_unset=True) | {"normalization_distance": "sensor"})


def test_the_textbooks_circle_of_confusion_at_life_size() -> None:
    """By hand: f 50, f/4, u = 2 f. What is 110 mm away has its image 50 110 / 60 = 91.67 mm behind the lens, and on the
    sensor, at 100 mm, a disc of 12.5 (100 - 91.67) / 91.67 = 1.1364 mm."""
    usual = Camera(focal_length=50.0, f_number=4.0, focus_distance=100.0, pixel_pitch=0.01)
    textbook = of_textbook(usual)
    assert 2 * 0.01 * float(blur_radius(textbook, 1 / 110)) == pytest.approx(1.1364, abs=5e-5)
    assert float(blur_radius(usual, 1 / 110) / blur_radius(textbook, 1 / 110)) == pytest.approx(1 - 50 / 100)
    assert ray_step(textbook) == 0.01 / 100.0  # life size: a pixel shows 0.01 mm at 100 mm
    assert diffraction_unit(textbook, 550.0) == pytest.approx(550e-6 * 4.0 * (1 + 1) / 0.01)  # N (1 + m)


def test_the_depth_of_field_of_calculators() -> None:
    """Hyperfocal distance H = f^2 / (N c) + f; sharp from u (H - f) / (H + u - 2 f) to u (H - f) / (H - u)."""
    f, number, u, c = 50.0, 8.0, 500.0, 0.03
    far_away = f * f / (number * c) + f
    near, far = u * (far_away - f) / (far_away + u - 2 * f), u * (far_away - f) / (far_away - u)
    assert (round(far_away), round(near, 1), round(far, 1)) == (10467, 479.3, 522.6)
    usual = Camera(focal_length=f, f_number=number, focus_distance=u, pixel_pitch=0.01)
    assert 2 * 0.01 * blur_radius(of_textbook(usual), np.array([1 / near, 1 / far])) == pytest.approx([-c, c])
    assert 2 * 0.01 * blur_radius(usual, np.array([1 / 477.1, 1 / 525.2])) == pytest.approx([-c, c], rel=1e-3)


def test_an_infinite_focus_has_the_sensor_at_the_focal_length() -> None:
    for far in (np.inf, "inf"):
        camera = Camera.model_validate({"focal_length": 35.0, "focus_distance": far})
        assert (camera.sensor_distance, camera.focused_distance, Lens.of(camera).focus_power) == (35.0, np.inf, 0.0)
