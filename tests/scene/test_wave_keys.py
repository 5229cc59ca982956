"""Keys of point spreads by waves that cannot be."""

from __future__ import annotations

import pytest

from tests.scene.test_bad_scenes import messages_of

OPENING = (
    'lens.keyframe[0].f_number: cannot change with psf.model = "wave" or aberrations, whose blur is that of one '
    "opening; got 2.0"
)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "psf.wavelengths = [620, 540, 460]",
            'psf.wavelengths: belongs to psf.model = "wave" or to aberrations; got [620.0, 540.0, 460.0]',
        ),
        (
            'psf = {model = "gaussian", bandwidth = 10}',
            'psf.bandwidth: belongs to psf.model = "wave", not "gaussian"; got 10',
        ),
        ("psf.tail = 0.1", 'psf.tail: belongs to psf.model = "wave", not "pillbox"; got 0.1'),
        ('psf.rest = "lose"', 'psf.rest: belongs to psf.model = "wave", not "pillbox"; got "lose"'),
        (
            'psf = {model = "wave", sigma_ratio = 1}',
            'psf.sigma_ratio: belongs to psf.model = "gaussian", not "wave"; got 1',
        ),
        ('psf = {model = "wave", edge = "area"}', 'psf.edge: must be "integrated" with psf.model = "wave"; got "area"'),
        (
            'psf = {model = "wave", edge = "sampled"}',
            'psf.edge: must be "integrated" with psf.model = "wave"; got "sampled"',
        ),
        ('psf = {model = "wave", wavelengths = 550}', "psf.wavelengths: must be a list of 3 numbers; got 550"),
        (
            'psf = {model = "wave", wavelengths = [99, 540, 465]}',
            "psf.wavelengths[0]: must be between 100 and 20000 nm; got 99",
        ),
        ('psf = {model = "wave", tail = 0.3}', "psf.tail: must be between 0.0001 and 0.2; got 0.3"),
        ('psf = {model = "wave", rest = "keep"}', 'psf.rest: must be renormalize or lose; got "keep"'),
        (
            'psf = {model = "gaussian", seidel = {W040 = 1.0}}',
            'psf.seidel: belongs to psf.model = "wave" or "pillbox", not "gaussian"; got a table of 1 keys',
        ),
        (
            'psf = {edge = "area", seidel = {W040 = 1.0}}',
            'psf.edge: must be "integrated" with psf.seidel or psf.zernike; got "area"',
        ),
        (
            "psf.seidel = {W040 = 1.0}\naperture.rim = [{distance = 20.0, diameter = 14.0}]",
            'aperture.rim: must be absent with psf.seidel or psf.zernike; got "some"',
        ),
        (
            "psf.seidel = {W040 = 1.0}\nlens.keyframe = [{time = 0.0, f_number = 2.0}, {time = 1.0, f_number = 4.0}]",
            OPENING,
        ),
        (
            "camera.resolution = [9, 9]\npsf.seidel = {W311 = 1.0}\nlens.keyframe = [{time = 0.0, f_number = 2.0}]",
            OPENING,
        ),
        (
            'psf = {model = "wave", seidel = {W131 = -20.5}}',
            "psf.seidel.W131: must be between -20 and 20 waves; got -20.5",
        ),
        ('psf = {model = "wave", seidel = {W404 = 1.0}}', "psf.seidel.W404: unknown key (did you mean W040?); got 1.0"),
        (
            'psf = {model = "wave", zernike = {"3,1" = 21}}',
            'psf.zernike."3,1": must be between -20 and 20 waves; got 21',
        ),
        ('psf = {model = "wave", zernike = {"3,2" = 1}}', 'psf.zernike."3,2": unknown key (did you mean 6,2?); got 1'),
        ('psf = {model = "wave", zernike = 3}', "psf.zernike: must be a table; got 3"),
        (
            'psf = {model = "wave", bandwidth = 470}',
            "psf.bandwidth: must be less than each of the wavelengths, of which one is 465 nm; got 470.0",
        ),
    ],
)
def test_bad_keys(line: str, message: str) -> None:
    assert messages_of(f'{line}\nobject = [{{shape = "sphere"}}]') == (f"bad.toml: {message}",)
