"""Every rule of [aperture], broken: each case has one fault and must give exactly its message."""

from __future__ import annotations

import pytest

from tests.scene.test_bad_scenes import messages_of

APERTURES: list[tuple[str, str]] = [
    (
        "aperture = {shape = 'ring', blades = 5}",
        'aperture.blades: belongs to aperture.shape = "polygon", not "ring"; got 5',
    ),
    (
        "aperture.rotation = 5.0",
        'aperture.rotation: belongs to aperture.shape = "polygon" or "image", not "circle"; got 5.0',
    ),
    (
        "aperture = {shape = 'ring', blade_curvature = 0.5}",
        'aperture.blade_curvature: belongs to aperture.shape = "polygon", not "ring"; got 0.5',
    ),
    (
        "aperture = {shape = 'polygon', blade_curvature = 1.5}",
        "aperture.blade_curvature: must be between -1 and 1; got 1.5",
    ),
    (
        "aperture = {shape = 'polygon', blades = 3, blade_curvature = -0.5}",
        "aperture.blade_curvature: must be at least -0.464 with 3 blades, which would cross one another; got -0.5",
    ),
    ("aperture.squeeze = 0.2", "aperture.squeeze: must be between 0.25 and 4; got 0.2"),
    ("aperture.exposure = 'darker'", 'aperture.exposure: must be normalized or area; got "darker"'),
    (
        "aperture.squeeze = 2.0\npsf.model = 'gaussian'",
        'aperture.squeeze: an aperture that is squeezed needs psf.model = "pillbox" or "wave"; got 2.0',
    ),
    (
        "aperture.squeeze = 2.0\npsf.edge = 'sampled'",
        'aperture.squeeze: an aperture that is squeezed needs psf.edge = "integrated" or "area"; got 2.0',
    ),
    ("aperture.obstruction = 0.5", 'aperture.obstruction: belongs to aperture.shape = "ring", not "circle"; got 0.5'),
    ("aperture = {shape = 'ring', obstruction = 1}", "aperture.obstruction: must be between 0.01 and 0.99; got 1"),
    ("aperture.rim = 3", "aperture.rim: must be an array of tables, [[aperture.rim]]; got 3"),
    (
        f"aperture.rim = [{', '.join(5 * ['{distance = 1.0, diameter = 2.0}'])}]",
        "aperture.rim: must hold at most 4 rims; got 5",
    ),
    ("aperture.rim = [{distance = 1.0}]", "aperture.rim[0].diameter: must be given; got nothing"),
    (
        "aperture.rim = [{distance = 2000.0, diameter = 2.0}]",
        "aperture.rim[0].distance: must be between -1000 and 1000 mm; got 2000.0",
    ),
    (
        "aperture.rim = [{distance = 1.0, diameter = 2.0}]\npsf.edge = 'sampled'",
        'aperture.rim: needs psf.edge = "integrated" or "area"; got "sampled"',
    ),
    (
        "aperture.rim = [{distance = -30.0, diameter = 2.0}]",
        "aperture.rim[0].distance: must be before the detector, 21.739 mm behind the lens; got -30.0",
    ),
    (
        "aperture.squeeze = 0.5\npsf = {model = 'wave', seidel = {W040 = 1.0}}",
        "aperture.squeeze: must be at least 1 with psf.seidel or psf.zernike, which are of a circle; got 0.5",
    ),
    ("aperture.shape = 'image'", 'aperture.image: is needed by aperture.shape = "image"; got none'),
]


@pytest.mark.parametrize(("line", "message"), APERTURES)
def test_bad_aperture(line: str, message: str) -> None:
    assert messages_of(f'{line}\nobject = [{{shape = "sphere"}}]') == (f"bad.toml: {message}",)
