"""Records: names, types, and what is refused or noted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clsco.data.record import Record, array_sha256, make_record, parse_stored
from clsco.errors import FileError, SceneError
from clsco.files.images import read_image
from clsco.files.transfer import encode
from clsco.frame.outputs import FILE_NAMES
from tests.data.samples import drawn, frame, record

FINITE = "radiance must be a finite number"


def test_arrays_of_one_frame() -> None:
    made = record(7)
    assert made.key == "000000007"
    assert list(made.arrays) == [*("color", "sharp", "depth", "coc", "mask", "filled", "object_id", "normal", "flow")]
    assert made["color"].dtype == np.uint16
    np.testing.assert_array_equal(made["color"], encode(frame(7).color, 16, "srgb"))
    np.testing.assert_array_equal(made["depth"], frame(7).depth)
    about = made.meta["arrays"]["color"]
    assert (about["dtype"], about["shape"], about["transfer"], about["clipped"]) == ("uint16", [9, 12, 3], "srgb", 0.0)
    assert made.meta["arrays"]["depth"]["unit"] == "mm"
    assert made.meta["frames"] == [{"prefix": "", "eye": "", "frame": 0, "samples": 1, "bits": 16}]  # no clock
    np.testing.assert_allclose(made.radiance(), frame(7).color, atol=2e-5)


@pytest.mark.parametrize(
    ("frames", "variants", "names"),
    [
        ([frame(1, index=3), frame(1, index=4)], 1, ["f0003.depth", "f0004.depth"]),
        ([frame(1, eye="left"), frame(1, eye="right")], 1, ["left.depth", "right.depth"]),
        ([frame(1)], 2, ["v00.color", "v01.color", "depth"]),
        (
            [frame(1, index=n, eye=eye) for n in (0, 1) for eye in ("left", "right")],
            2,
            [f"v0{v}.f000{n}.{eye}.color" for v in (0, 1) for n in (0, 1) for eye in ("left", "right")]
            + [f"f000{n}.{eye}.depth" for n in (0, 1) for eye in ("left", "right")],
        ),
    ],
)
def test_names_have_what_there_is_several_of(frames: list[object], variants: int, names: list[str]) -> None:
    wanted = ("depth",) if variants == 1 else ("color", "depth")
    made = make_record(drawn(1, variants), 0, [frames] * variants, wanted)  # type: ignore[list-item]
    assert list(made.arrays) == names
    prefixes = [each["prefix"] for each in made.meta["frames"]]
    assert [f"{prefix}{wanted[0]}" for prefix in prefixes] == names[: len(prefixes)]


def test_variants_share_what_does_not_depend_on_the_lens() -> None:
    sample = drawn(1, 2)
    nearer = replace(frame(1), depth=frame(2).depth)
    apart = make_record(sample, 0, [[frame(1)], [nearer]], ("color", "depth", "mask"))
    assert list(apart.arrays) == ["v00.color", "v00.depth", "v01.color", "v01.depth", "mask"]
    scenes = tuple(scene.replace("object.0.radius", 20.0 + k) for k, scene in enumerate(sample.scenes))
    others = make_record(replace(sample, scenes=scenes), 0, [[frame(1)], [frame(1)]], ("color", "depth"))
    assert "v01.depth" in others.arrays


def test_variants_are_stacked() -> None:
    made = make_record(drawn(1, 2), 0, [[frame(1)], [frame(2)]], ("color", "depth"))
    whole = made.stacked()
    assert whole["color"].shape == (2, *made["v00.color"].shape)
    np.testing.assert_array_equal(whole["color"][1], made["v01.color"])
    assert whole["depth"].ndim == (2 if "depth" in made.arrays else 3)
    assert whole.meta["arrays"]["color"]["shape"] == list(whole["color"].shape)
    assert whole.radiance("color").dtype == np.float32
    assert record(7, wanted=("color",)).stacked().arrays.keys() == {"color"}
    uneven = Record("000000001", {"v00.color": np.zeros((2, 2)), "v01.color": np.zeros((3, 2))}, {"arrays": {}})
    with pytest.raises(FileError, match="record 000000001: color must be alike in all variants"):
        uneven.stacked()


def test_codes_note_what_they_clip() -> None:
    color = np.full((4, 5), 0.5, np.float32)
    color[0, 0], color[0, 1], color[0, 2] = 3.0, 1 + 1e-6, -0.01  # the second one is white, rounded
    made = make_record(drawn(1), 0, [[replace(frame(1), color=color)]], ("color",))
    assert made.meta["arrays"]["color"]["clipped"] == 2 / 20
    assert made["color"][0, :3].tolist() == [65535, 65535, 0]
    exact = make_record(drawn(1), 0, [[replace(frame(1), color=color)]], ("color",), {"color": "float32"})
    np.testing.assert_array_equal(exact["color"], color)
    np.testing.assert_array_equal(exact.radiance(), color)
    assert "clipped" not in exact.meta["arrays"]["color"]


@pytest.mark.parametrize(
    ("name", "value", "stored", "rule"),
    [
        ("color", np.nan, {}, f"sample 1: color: {FINITE}; got nan at row 2, column 3 (1 in all)"),
        ("color", -np.inf, {}, f"{FINITE}; got -inf"),
        ("depth", 1e5, {"depth": "float16"}, "sample 1: depth: sizes must be at most 65504 in float16; got 100000"),
    ],
)
def test_what_does_not_fit_is_refused(name: str, value: float, stored: dict[str, str], rule: str) -> None:
    made = frame(1)
    array = getattr(made, name).copy()
    array[(2, 3, 0) if array.ndim == 3 else (2, 3)] = value
    with pytest.raises(FileError) as error:
        make_record(drawn(1), 0, [[replace(made, **{name: array})]], (name,), stored)
    assert rule in str(error.value)


def test_infinite_depth_fits_float16() -> None:
    made = make_record(drawn(1), 0, [[frame(1)]], ("depth", "mask"), {"depth": "float16"})
    assert made["depth"].dtype == np.float16
    np.testing.assert_array_equal(np.isfinite(made["depth"]), made["mask"])


def test_types_are_parsed_with_all_faults() -> None:
    assert parse_stored("color=uint8,depth=float16") == {"color": "uint8", "depth": "float16"}
    assert parse_stored("") == {}
    with pytest.raises(SceneError) as error:
        parse_stored("colour=uint8,depth=uint16,coc=float32,coc=float16,sharp")
    assert [message.partition(":")[2] for message in error.value.messages] == [
        f" must name arrays, some of {', '.join(FILE_NAMES.values())}; got colour=uint8",
        " depth must be one of float32, float16; got depth=uint16",
        " must name each array once; got coc twice",
        " sharp must be one of float32, float16, uint8, uint16; got sharp",
    ]


def test_digests_know_type_and_shape() -> None:
    values = np.arange(6, dtype=np.float32)
    others = values.reshape(2, 3), values.astype(np.float64), values.view("i4")
    assert len({array_sha256(each) for each in (values, *others)}) == 4
    assert array_sha256(values.astype(">f4")) == array_sha256(values)
    assert array_sha256(np.asfortranarray(values.reshape(2, 3))) == array_sha256(values.reshape(2, 3))


def test_a_record_prints_as_one_line_and_shows_its_images() -> None:
    made = record(7, wanted=("color", "depth"))
    assert repr(made) == "<Record '000000007' of 'train': color 9x12x3 uint16, depth 9x12 float32>"
    np.testing.assert_array_equal(made.image(), frame(7).image())
    assert made._repr_html_().count("<img") == 1


def test_a_name_that_a_record_lacks_is_answered_by_those_it_has(tmp_path: Path) -> None:
    made = record(7, wanted=("color", "depth"))
    for call in (lambda: made["colour"], lambda: made.image("colour"), lambda: made.radiance("colour")):
        with pytest.raises(KeyError, match="record 000000007: must be one of color, depth; got colour"):
            call()
    for show in (lambda: made.image("depth"), lambda: made.save(tmp_path / "depth.png", "depth")):
        with pytest.raises(SceneError, match="name: must be an image, color or sharp; got depth"):
            show()
    made.save(tmp_path / "record.png")
    np.testing.assert_array_equal(read_image(tmp_path / "record.png").data, made["color"])
    made.save(tmp_path / "record.npz")
    with np.load(tmp_path / "record.npz") as saved:
        assert set(saved) == {"color", "depth"}
