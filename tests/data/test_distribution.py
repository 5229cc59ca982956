"""Distribution files: how they join, what they draw, and that samples are a function of seed and number."""

from __future__ import annotations

import pickle
import subprocess
import sys
import tomllib
from collections.abc import Callable
from math import erf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from clsco.data.acceptance import looks_of
from clsco.data.build import located
from clsco.data.compile import Parameter
from clsco.data.distribution import Distribution, draw_value
from clsco.data.draws import split_of, splits_of
from clsco.errors import SceneError
from clsco.reference.trace.truth import ground_truth
from clsco.scene.sweep import parse_sweep
from clsco.scene.toml import toml_text
from tests.data.distributions import SCENE, Load


def first_values(distribution: Distribution, count: int) -> dict[str, list[Any]]:
    """Values of each parameter that the first attempts of samples draw, those of the objects of a population together,
    and how many objects each has."""
    parts, values = distribution.parts, dict[str, list[Any]]()

    def draw(number: int, parameter: Parameter, element: int = 0) -> Any:
        values.setdefault(parameter.name, []).append(draw_value(1, number, 0, 1, parameter, element))
        return values[parameter.name][-1]

    for number in range(count):
        for parameter in parts.parameters:
            draw(number, parameter)
        for population in parts.populations:
            for element in range(draw(number, population.count)):
                for parameter in population.parameters:
                    draw(number, parameter, element)
    return values


ALL = """
[vary.camera]
focus_distance = { uniform = [300, 500] }
f_number = { choice = [2, 4, 8], weights = [1, 2, 1] }
[vary.sequence]
interval = { log_uniform = [0.01, 1] }
[[vary.object]]
index = 0
slope_x = { normal = [0, 0.2], clip = [-0.5, 0.5] }
motion.velocity = [{ normal = [0, 1] }, 0, { uniform = [1, 2] }]
[[vary.object]]
name = "ball"
count = { integers = [0, 3] }
shape = "sphere"
radius = { log_uniform = [5, 40] }
center = { frustum = { depth = [200, 350], margin = 4 } }
rotation = { rotation = "uniform" }
motion.angular_velocity = { uniform = [-5, 5], size = 3 }
"""


def test_a_sample_does_not_depend_on_other_parameters(load: Load) -> None:
    before = load(ALL)
    more = ALL.replace("[vary.camera]", '[[vary.object]]\nshape = "disc"\nradius = { uniform = [1, 2] }\n[vary.camera]')
    more = more.replace("[vary.sequence]", "focal_length = { uniform = [19, 21] }\n[vary.sequence]")
    after = load(more, name="more.toml")
    for number in range(5):
        one, other = before.draw(9, number), after.draw(9, number)
        added = other.parameters.keys() - one.parameters.keys()
        assert any("population_0" in name for name in added)
        centers = {name for name in one.parameters if name.endswith("center")}  # they follow from the focal length
        rest = one.parameters.keys() - centers
        assert all(other.parameters[name] == one.parameters[name] for name in rest)
        assert all(other.parameters[name][2] == one.parameters[name][2] for name in centers)


def test_samples_are_the_same_in_another_process_and_after_pickling(load: Load, tmp_path: Path) -> None:
    distribution = load(ALL, splits="train=0.5,test=0.5")
    here = [distribution.draw(5, number) for number in range(4)]
    again = pickle.loads(pickle.dumps(distribution))
    assert all(again.draw(5, number) == here[number] for number in (3, 1, 0, 2))
    code = (
        "import sys; from clsco.data.distribution import load_distribution\n"
        "d = load_distribution(sys.argv[1], splits='train=0.5,test=0.5')\n"
        "print(d.digest, [(s.split, s.parameters, s.table) for s in (d.draw(5, k) for k in range(4))])"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "set.toml")]
    there = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    assert there == f"{distribution.digest} {[(s.split, s.parameters, s.table) for s in here]}"


def test_the_table_of_a_sample_renders_it_by_itself(load: Load) -> None:
    distribution = load(ALL)
    for number in range(3):
        sample = distribution.draw(1, number)
        sweep = parse_sweep(located(sample.table, distribution.folder))
        assert (sweep.labels, sweep.scenes) == (sample.labels, sample.scenes)
        assert parse_sweep(tomllib.loads(toml_text(located(sample.table, distribution.folder)))).scenes == sample.scenes
        assert len(sample.scenes[0].objects) == 1 + sample.parameters["object.ball.count"]


def assert_distributed(values: Any, distribution: Callable[[Any], Any]) -> None:
    """Test of Kolmogorov and Smirnov at 1 %."""
    theory = np.asarray(distribution(np.sort(values)))
    steps = np.arange(len(values) + 1) / len(values)
    assert max((steps[1:] - theory).max(), (theory - steps[:-1]).max()) < 1.63 / np.sqrt(len(values))


def test_values_follow_their_distributions(load: Load) -> None:
    count = 1000
    values = first_values(load(ALL), count)
    assert_distributed(values["camera.focus_distance"], lambda u: (u - 300) / 200)
    assert_distributed(values["sequence.interval"], lambda t: 1 + np.log10(t) / 2)
    assert_distributed(values["object.0.motion.velocity.0"], lambda v: [0.5 + 0.5 * erf(x / 2**0.5) for x in v])
    inside = np.abs(values["object.0.slope_x"]) < 0.5
    assert 0.98 < inside.mean() < 0.995  # 2.5 standard deviations
    assert np.abs(values["object.0.slope_x"]).max() == 0.5
    shares = [values["camera.f_number"].count(entry) / count for entry in (2, 4, 8)]
    assert np.abs(np.subtract(shares, [0.25, 0.5, 0.25])).max() < 0.03
    counts = np.bincount(values["object.ball.count"], minlength=4)
    assert ((counts - count / 4) ** 2).sum() / (count / 4) < 11.34  # chi square of three degrees of freedom at 1 %
    assert_distributed(values["object.ball.radius"], lambda r: np.log2(r / 5) / 3)
    centers = values["object.ball.center"]
    depth = [center.depth for center in centers]
    assert_distributed(depth, lambda z: (z**3 - 200**3) / (350**3 - 200**3))  # as the volume
    for place in zip(*((center.across, center.up) for center in centers), strict=True):
        assert_distributed(place, lambda x: (x + 1) / 2)
    rotation = np.array([value["quaternion"] for value in values["object.ball.rotation"]])
    turning = np.array(values["object.ball.motion.angular_velocity"])
    assert np.abs((rotation**2).sum(axis=1) - 1).max() < 1e-15
    # Of a uniform unit quaternion, the square of a component has the beta distribution of 1/2 and 3/2.
    assert_distributed(rotation[:, 0], lambda w: 0.5 + (np.arcsin(w) + w * np.sqrt(1 - w * w)) / np.pi)
    assert turning.shape == (len(depth), 3)
    assert abs(np.corrcoef(turning.T)[0, 1]) < 0.05


def test_points_in_the_frustum_are_in_the_frame(load: Load) -> None:
    distribution = load(
        '[[vary.object]]\ncount = 30\nshape = "sphere"\nradius = 1\n'
        'center = { frustum = { depth = [100, 300], margin = 10, density = "depth" } }'
    )
    sample = distribution.draw(1, 1)
    camera = sample.scenes[0].camera
    step = camera.pixel_pitch / camera.normalization_distance
    centers = np.array([value for name, value in sample.parameters.items() if name.endswith("center")])
    assert centers.shape == (30, 3)
    assert (np.abs(centers[:, 0]) <= (32 - 10) * step * centers[:, 2] * (1 + 1e-12)).all()
    assert (np.abs(centers[:, 1]) <= (24 - 10) * step * centers[:, 2] * (1 + 1e-12)).all()
    assert ((centers[:, 2] >= 100) & (centers[:, 2] <= 300)).all()
    assert np.ptp(centers[:, 0]) > 20 * step * 200


def test_a_base_is_joined_key_by_key(load: Load, tmp_path: Path) -> None:
    (tmp_path / "first.toml").write_text(
        'title = "first"\n[camera]\nresolution = [32, 24]\naperture_diameter = 5.0\nsensor_distance = 21.5\n'
        '[[object]]\nshape = "sphere"\n[vary.camera]\nfocal_length = { uniform = [19, 20] }\n'
        "[accept]\nmax_blur_px = 90\n"
    )
    (tmp_path / "second.toml").write_text(
        'base = "first.toml"\ntitle = "second"\n[vary.camera]\nfocal_length = { choice = [18] }\n'
    )
    scene = 'base = "second.toml"\n[camera]\nf_number = 4.0\n[vary.camera]\nfocus_distance = { uniform = [250, 260] }\n'
    sample = load('[[object]]\nshape = "disc"', scene).draw(1, 1)
    camera = sample.scenes[0].camera
    assert (camera.resolution, camera.focal_length, camera.f_number) == ((32, 24), 18, 4.0)
    assert 250 <= (camera.focus_distance or 0) <= 260
    assert sample.scenes[0].title == "second"
    assert [item.shape for item in sample.scenes[0].objects] == ["disc"]  # an array of tables is replaced
    assert load("", scene).accept == (("max_blur_px", -np.inf, 90.0),)


def test_overrides_fix_what_varies(load: Load) -> None:
    given = ["camera.focus_distance=350", "object.0.slope_x=0.25", "vary.camera.f_number={uniform=[3, 5]}"]
    distribution = load(ALL, overrides=given)
    names = [one.name for one in distribution.parts.parameters]
    assert not {"camera.focus_distance", "object.0.slope_x"}.intersection(names)
    sample = distribution.draw(1, 0)
    assert sample.scenes[0].camera.focus_distance == 350
    assert sample.scenes[0].objects[0].slope_x == 0.25  # type: ignore[union-attr]
    assert 3 <= sample.parameters["camera.f_number"] <= 5
    assert "camera.f_number" not in [
        p.name for p in load(ALL, overrides=["camera.aperture_diameter=5"]).parts.parameters
    ]
    assert distribution.digest != load(ALL).digest


def test_a_pair_of_focus_settings_is_one_sample(load: Load) -> None:
    text = "[vary.camera]\nfocus_distance = [{ uniform = [300, 310] }, { uniform = [390, 400] }]"
    sample = load(text).draw(1, 7)
    assert len(sample.scenes) == len(sample.labels) == 2
    assert [s.camera.focus_distance for s in sample.scenes] == [
        sample.parameters["camera.focus_distance.0"], sample.parameters["camera.focus_distance.1"],
    ]  # fmt: skip
    values = '{ from = { uniform = [300, 310] }, to = 400, steps = 5, spacing = "diopters" }'
    stack = load(f"[vary.camera]\nfocus_distance = {values}").draw(1, 7)
    focus = [scene.camera.focused_distance for scene in stack.scenes]
    assert focus[-1] == 400
    assert np.diff([1 / each for each in focus]) == pytest.approx([(1 / 400 - 1 / focus[0]) / 4] * 4)


def test_shapes_of_a_population_take_the_keys_that_they_have(load: Load) -> None:
    text = (
        '[[vary.object]]\ncount = 20\nshape = { choice = ["sphere", "cone", "ellipsoid"] }\n'
        "radius = { uniform = [5, 6] }\ncenter = { frustum = { depth = [300, 310] } }\nsemi_axes = [5, 6, 7]"
    )
    sample = load(text).draw(1, 1)
    kinds = {item.shape for item in sample.scenes[0].objects[1:]}
    assert kinds == {"sphere", "cone", "ellipsoid"}
    for item in sample.table["object"][1:]:
        place = item["apex"] if item["shape"] == "cone" else item["center"]
        assert 300 <= place[2] <= 310
        assert ("radius" in item) == (item["shape"] == "sphere")
        assert ("semi_axes" in item) == (item["shape"] == "ellipsoid")


def test_keyframes_vary(load: Load) -> None:
    keys = (
        "{ time = 0 }, { time = 1, position = [{ uniform = [2, 9] }, 0, 0], rotation = { normal = [0, 5], size = 3 } }"
    )
    text = (
        f"[[vary.object]]\nindex = 0\nmotion.keyframe = [{keys}]\n"
        f'[[vary.object]]\ncount = 2\nshape = "sphere"\ncenter = [0, 0, 300]\nmotion.keyframe = [{keys}]\n'
        f"[vary.camera]\nmotion.keyframe = [{keys}]\nmotion.interpolation = {{ choice = ['linear', 'cubic'] }}"
    )
    distribution = load(text)
    first, second = (distribution.draw(1, number) for number in (0, 1))
    for sample in (first, second):
        (scene,) = sample.scenes
        for motion in (scene.camera.motion, *(item.motion for item in scene.objects)):
            assert motion.keyframe is not None
            assert motion.keyframe[0].position == (0.0, 0.0, 0.0)
            assert 2.0 <= motion.keyframe[1].position[0] <= 9.0
            assert any(motion.keyframe[1].rotation)
        places = [item.motion.keyframe[1].position for item in scene.objects if item.motion.keyframe]
        assert len(set(places)) == 3
    assert (
        first.parameters["object.0.motion.keyframe.1.position.0"]
        != second.parameters["object.0.motion.keyframe.1.position.0"]
    )
    with pytest.raises(SceneError, match=r"vary.object\[0\].motion.keyframe\[0\].time"):
        load("[[vary.object]]\nindex = 0\nmotion.keyframe = [{ time = { unifrm = [1, 2] } }]").draw(1, 0)


def images(folder: Path, count: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(count):
        Image.fromarray(np.full((4, 4), k, np.uint8)).save(folder / f"{k:03d}.png")


def test_a_texture_never_occurs_in_two_splits(load: Load, tmp_path: Path) -> None:
    images(tmp_path / "textures" / "a", 60)
    (tmp_path / "textures" / "b").mkdir()
    (tmp_path / "textures" / "b" / "copy.png").write_bytes((tmp_path / "textures" / "a" / "007.png").read_bytes())
    text = '[[vary.object]]\nindex = 0\ntexture = { files = "textures/**/*.png", split = "by_file" }'
    distribution = load(text, splits="train=0.7,val=0.15,test=0.15")
    seen: dict[str, set[bytes]] = {"train": set(), "val": set(), "test": set()}
    for number in range(300):
        sample = distribution.draw(1, number)
        path = tmp_path / sample.table["object"][0]["texture"]
        assert path.is_file()
        assert sample.scenes[0].objects[0].texture == str(path.resolve())
        seen[sample.split].add(path.read_bytes())
    assert all(seen.values())
    assert not seen["train"] & seen["val"]
    assert not (seen["train"] | seen["val"]) & seen["test"]
    assert len(seen["train"]) > 25
    (tmp_path / "textures" / "a" / "003.png").write_bytes(b"other")
    assert load(text, splits="train=0.7,val=0.15,test=0.15").digest != distribution.digest


def test_splits_do_not_depend_on_the_count_and_have_their_shares(load: Load) -> None:
    splits = (("train", 0.9), ("val", 0.05), ("test", 0.05))
    places = [split_of(splits, 3, number) for number in range(5000)]
    for first in range(0, 5000, 20):
        assert np.bincount(places[first : first + 20]).tolist() == [18, 1, 1]
    assert len({tuple(places[first : first + 20]) for first in range(0, 5000, 20)}) > 100
    distribution = load(ALL, splits=dict(splits))
    assert [distribution.draw(3, k).split for k in range(30)] == [splits[k][0] for k in places[:30]]


def test_samples_with_one_value_share_a_split(load: Load, tmp_path: Path) -> None:
    options = {"splits": "a=3,b=1", "split_by": "camera.f_number"}
    for form, least, most in (("integers = [4, 11]", 2, 2), (f"choice = {[0.5 * k for k in range(2, 62)]}", 5, 25)):
        distribution = load(f"[vary.camera]\nf_number = {{ {form} }}", **options)
        samples = [distribution.draw(3, number) for number in range(400)]
        values = [{each.parameters["camera.f_number"] for each in samples if each.split == name} for name in "ab"]
        assert not values[0] & values[1]
        assert least <= len(values[1]) <= most
    assert distribution.digest != load("", splits="a=3,b=1").digest
    for more in ({"split_by": "f_number"}, {"splits": ""}):
        with pytest.raises(SceneError, match="split_by: must be a parameter of samples in splits; got "):
            load("", **options | more).draw(1, 0)
    images(tmp_path, 2)
    with pytest.raises(SceneError, match="files must be without split where a parameter decides the split"):
        load('[[vary.object]]\nindex = 0\ntexture = { files = "*.png", split = "by_file" }', **options)


def test_only_accepted_samples_are_drawn(load: Load) -> None:
    text = (
        "[vary.camera]\nfocus_distance = { uniform = [200, 400] }\n[accept]\nmax_blur_px = 6\n"
        "visible_fraction = { min = 0.5 }\nvalid_fraction = 1\n"
        '[[vary.object]]\nshape = "sphere"\nradius = 5\ncenter = [{ uniform = [-20, 20] }, 0, 300]'
    )
    distribution = load(text)
    samples = [distribution.draw(1, number) for number in range(8)]
    assert max(sample.attempts for sample in samples) > 1
    assert all(distribution.draw(1, sample.number) == sample for sample in samples[:2])
    for sample in samples:
        (look,) = looks_of(sample.scenes)
        assert look.measure("max_blur_px") <= 6
        assert look.visible >= 0.5
    with pytest.raises(
        SceneError, match=r"accept: must hold for one of 100 attempts; got .*max_blur_px must be at most"
    ):
        load(text.replace("max_blur_px = 6", "max_blur_px = 0.01")).draw(1, 0)


def test_what_is_seen_is_what_the_reference_sees(load: Load) -> None:
    scene = (
        load(
            '[[object]]\nshape = "sphere"\nradius = 30\ncenter = [5, 0, 280]\nmotion.velocity = [8, 2, -5]\n'
            "[sequence]\ninterval = 0.4\n[vary.camera]\nf_number = { choice = [2] }",
            SCENE.replace("[64, 48]", "[64, 64]").replace(
                "400.0", "400.0\nbounds = [[-40, 200], [-200, 200], [-1, 1]]"
            ),
        )
        .draw(1, 1)
        .scenes[0]
    )
    truth = ground_truth(scene, (np.zeros((64, 64, 1)),) * 2, 0)
    (look,) = looks_of([scene])
    assert look.valid == truth.mask.mean()  # as many rays as pixels, at their centers
    assert look.measure("max_blur_px") == pytest.approx(np.abs(truth.blur_radius[truth.mask]).max(), rel=1e-9)
    assert look.measure("max_flow_px") == pytest.approx(np.linalg.norm(truth.flow[truth.mask], axis=-1).max(), rel=1e-9)
    assert np.sort(1 / look.inverse_depth) == pytest.approx(np.sort(truth.depth[truth.mask]), rel=1e-9)


def test_keys_that_follow_give_what_is_wanted(load: Load) -> None:
    text = (
        "[vary.camera]\nmotion.velocity = { normal = [0, 20], size = 3, clip = [-40, 40] }\n[sequence]\nframes = 3\n"
        "[derive]\ncamera.focus_distance = { depth_quantile = 0.5 }\ncamera.f_number = { largest_blur_px = 7 }\n"
        "sequence.interval = { largest_flow_px = { uniform = [2, 6] } }\n"
        "sequence.shutter = { share_of_interval = 0.25 }\n"
        '[[vary.object]]\nshape = "sphere"\nradius = 30\ncenter = [0, 0, { uniform = [250, 300] }]'
    )
    distribution = load(text)
    for number in range(4):
        sample = distribution.draw(1, number)
        (scene,) = sample.scenes
        assert scene.sequence.shutter == pytest.approx(0.25 * scene.sequence.interval, rel=1e-5)
        wanted = sample.parameters["derive.sequence.interval"]
        still = scene.replace("sequence.shutter", 1e-9).replace("sequence.frames", 1)
        (look,) = looks_of([still])
        assert look.measure("max_flow_px") == pytest.approx(wanted, rel=1e-4)
        (look,) = looks_of([scene])
        assert look.measure("max_blur_px") == pytest.approx(7, rel=1e-3)
        u = scene.camera.focus_distance or 0.0
        assert (look.inverse_depth >= 1 / u).mean() == pytest.approx(0.5, abs=0.01)
        assert sample.parameters["sequence.interval"] == scene.sequence.interval


def test_numbers_of_samples_are_shares_as_well() -> None:
    for given in ("train=80,test=20", {"train": 4, "test": 1}, {"train": 0.8, "test": 0.2}):
        splits = splits_of(given)
        assert splits == (("train", 0.8), ("test", 0.2))
        assert sum(split_of(splits, 1, number) for number in range(100)) == 20
    thirds = splits_of({"a": 1, "b": 1, "c": 1})
    assert np.bincount([split_of(thirds, 1, number) for number in range(99)]).tolist() == [33, 33, 33]
    odd = splits_of({"a": 0.123456, "b": 0.876544})
    assert 120 <= sum(split_of(odd, 1, number) == 0 for number in range(1000)) <= 127


@pytest.mark.parametrize(
    ("given", "rule"),
    [
        ("train", "must be NAME=SHARE"),
        ("train=0.5", "shares must be 1 in all; got 0.5"), ("a=0.5,A=0.5", "names must differ"),
        ("../x=1", "a name must be 1 to 64 letters"),
        ("a=nan", "a share must be between"), ([("a", True)], "a share must be"),
        ([(f"s{k}", 0.02) for k in range(50)], "at most 32 splits"),
    ],
)  # fmt: skip
def test_bad_splits_are_refused(given: Any, rule: str) -> None:
    with pytest.raises(SceneError, match=rule):
        splits_of(given)


@pytest.mark.parametrize(("seed", "number"), [(-1, 0), (2**64, 0), (1.0, 0), (True, 0), (0, -1), (0, 2**63), (0, "1")])
def test_bad_seeds_and_numbers_are_refused(load: Load, seed: Any, number: Any) -> None:
    with pytest.raises(SceneError, match="must be an integer between 0 and"):
        load(ALL).draw(seed, number)
    assert load(ALL).draw(2**64 - 1, 2**63 - 1).attempts == 1


def test_a_sample_that_is_no_scene_is_refused_with_its_number(load: Load) -> None:
    entries = [2.0, -1.0, *range(3, 100)]  # not all of so many are looked at when the file is read
    distribution = load(f"[vary.camera]\nf_number = {{ choice = {entries} }}")
    number = first_values(distribution, 1000)["camera.f_number"].index(-1.0)
    with pytest.raises(SceneError, match=rf"vary.camera.f_number: must be .*; got -1.0 \(sample {number}, seed 1\)"):
        distribution.draw(1, number)
    assert distribution.draw(1, number + 1).attempts == 1
