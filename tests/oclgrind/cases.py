"""Cases for Oclgrind: small scenes and images that ask for every pair of features, in many shapes.

A scene is drawn from CHOICES; its features are those that clsco itself compiles its kernels for. All features together
would be too many (over 10^6); of drawn scenes those are taken that add pairs of features until no drawn one adds any.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from itertools import combinations, islice, product
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from clsco.engine.defocus import defocus
from clsco.engine.inpaint import inpaint
from clsco.engine.sequence import render_sweep
from clsco.errors import SceneError
from clsco.frame.outputs import ALL_TRUTH
from clsco.frame.strips import Strip
from clsco.inputs.textures import Texture
from clsco.opencl.buffers import upload
from clsco.optics.motion import Eye
from clsco.optics.sensor import SensorModel, sensor_model
from clsco.optics.stencil import SUMMED
from clsco.passes.blur import Plane as Plane2D
from clsco.passes.blur import blur_features
from clsco.passes.sensor import FrameSensor
from clsco.passes.warp import forward_features
from clsco.plan.buffers import padded_columns
from clsco.plan.device import ThisMachine
from clsco.plan.plan import Plan
from clsco.plan.request import Request
from clsco.records import flat
from clsco.reference.sensor.sensor import sense
from clsco.scene.aberrations import Seidel
from clsco.scene.model import (
    Aperture,
    Camera,
    Cone,
    Cylinder,
    DepthMap,
    Fill,
    Lens,
    Light,
    Motion,
    Object,
    ObjectMotion,
    Plane,
    Psf,
    Quadric,
    Rectangle,
    Scene,
    Sensor,
    Sphere,
    Stereo,
)
from clsco.scene.model import Sequence as Frames
from clsco.scene.spread import Rim
from tests.scenes import plan_scene

Array = NDArray[Any]
# Rows and columns: single pixels and lines, odd and even, less than a vector of 8 or 16, whole ones, and one more.
SHAPES = (
    (1, 1), (1, 2), (2, 1), (1, 7), (7, 1), (1, 16), (17, 1), (2, 2), (3, 3), (2, 9), (5, 4), (4, 8), (8, 5), (7, 7),
    (6, 9), (8, 8), (3, 15), (9, 6), (2, 17), (5, 11), (1, 31), (3, 23), (10, 3), (32, 1),
)  # fmt: skip
DRAWN, SEED = 200, 1
MOST = 4000.0  # px: of a scene, see `cost`
BUILD, HIDDEN = 200.0, 5.0  # px: to compile a scene's kernels; of each object that may be in the way of a pixel
EVERY = int(os.environ.get("CLSCO_EVERY", "1"))  # of scenes and images one of so many is run, for a quick look
MOTION = ObjectMotion(velocity=(0.9, -0.4, -90.0), angular_velocity=(3.0, -2.0, 5.0))
FAR = Plane(distance=300.0, slope_x=0.2, name="far")
BALL = Sphere(center=(0.5, 0.3, 230.0), radius=2.0)
LAID: dict[str, Any] = {"texture_mapping": "surface"}
OBJECTS: dict[str, tuple[Object, ...]] = {
    "card": (Plane(distance=280.0),),
    "plane": (FAR,),
    "bounded plane": (FAR.model_copy(update={"bounds": ((-2.0, 2.5), (-1.5, 2.0), (-9.0, 9.0))}),),
    "ball": (BALL,),
    "cylinder": (Cylinder(center=(0.0, 0.1, 270.0), radius=2.0, axis=(1.0, 0.2, 0.3)),),
    "cone": (Cone(apex=(0.0, 0.0, 240.0), half_angle=20.0),),
    "paraboloid": (Quadric(center=(0.0, 0.0, 260.0), coefficients=(1, 2, 0, 0.3, 0, 0, 0, 0, -20, 0)),),
    "ball before plane": (BALL, FAR),
    "three": (BALL, FAR, Cone(apex=(1.0, 0.0, 215.0), half_angle=5.0, bounds=((-9.0, 9.0), (-9.0, 9.0), (-9.0, 9.0)))),
    "laid card": (Rectangle(size=(5.0, 4.0), center=(0.0, 0.0, 280.0), **LAID), FAR),
    "laid ball": (BALL.model_copy(update=LAID),),
    "cube map": (BALL.model_copy(update={"texture_mapping": "cube"}),),
    "laid cone": (Cone(apex=(0.0, 0.0, 240.0), half_angle=20.0, texture_size=(2.0,), texture_wrap="none", **LAID),),
    "triplanar": (BALL.model_copy(update={"texture_mapping": "triplanar", "texture_size": (1.0,)}), FAR),
    "map": (DepthMap(depth="map.npy", center=(0.1, 0.0, 260.0)),),
    "map before plane": (DepthMap(depth="map.npy", center=(0.1, 0.0, 260.0)), FAR),
}
CHOICES: dict[str, Sequence[Any]] = {
    "objects": [*OBJECTS, "ball before plane", "three"],
    "shape": [(rows, columns) for rows, columns in SHAPES if rows * columns <= 20],  # with a guard band of 8 px or more
    "model": ("pillbox", "gaussian", "wave"),
    "edge": ("integrated", "area", "sampled"),
    "tilt": (True, False),
    "silhouette_samples": (1, 2, 3),
    "occlusion": (None, None, "layered", "none"),
    "border": ("lose", "lose", "renormalize"),
    "motion": (None, None, "bicubic", "bilinear", "nearest", "forward", "forward"),
    "fill": ("ait", "mean_median", "none"),
    "domain": ("surface", "span"),
    "stereo": (False, False, False, True),
    "light": (None, None, None, Light(position=(-5.0, 8.0, 150.0), ambient=0.2)),
    "channels": (1, 3),
    "method": ("auto", "auto", "gather", "scatter", "tiles"),
    "truth": ("none", "all", "one", "some"),
    "lenses": (1, 1, 1, 2),
    "precision": ("double", "double", "single"),
    "aperture": (0.0001, 0.6, 1.2),  # mm: in focus, and |R| of about 1 and 2 px
    "opening": (None, None, None, "blades", "rims"),
    "device": ({}, {}, {"kind": "gpu"}, {"has_int64_atomics": False}, {"compute_units": 3}),
    "seed": range(1000),
}
OPENINGS = {
    "blades": Aperture(shape="polygon", blades=5, blade_curvature=0.5),
    "rims": Aperture(rim=(Rim(distance=40.0, diameter=1.0), Rim(distance=-5.0, diameter=0.7))),
}
Drawn = dict[str, Any]
Pair = tuple[tuple[str, Any], tuple[str, Any]]


@dataclass(frozen=True)
class Case:
    """Something to run on a device like `device`; about: what it was drawn as."""

    name: str
    device: dict[str, Any]
    run: Callable[[], list[Array]]
    about: str = ""
    channels: int = 1


def scenes_of(drawn: Drawn) -> list[Scene]:
    """The scene, once for each lens. Raises ValueError where these choices do not go together."""
    psf = {key: drawn[key] for key in ("model", "edge", "tilt", "silhouette_samples", "border")}
    psf |= {"occlusion": drawn["occlusion"]} if drawn["occlusion"] else {}
    if drawn["model"] == "wave":
        psf |= {"tail": 0.1, "zernike": {"3,1": 0.1 * (drawn["seed"] % 2)}}
    sections: dict[str, Any] = {"psf": Psf(**psf)}
    items = OBJECTS[drawn["objects"]]
    if drawn["motion"] is not None:
        items = tuple(item.model_copy(update={"motion": MOTION}) for item in items)
        forward = drawn["motion"] == "forward"
        sections["motion"] = Motion(warp="forward") if forward else Motion(texture_filter=drawn["motion"])
        sections["sequence"] = Frames(samples=1 + (drawn["seed"] % 4 == 0))
        if forward:
            sections["fill"] = Fill(method=drawn["fill"], domain=drawn["domain"])
    if drawn["opening"] is not None:
        sections["aperture"] = OPENINGS[drawn["opening"]]
    if drawn["light"] is not None:
        sections["light"] = drawn["light"]
    if drawn["stereo"]:
        sections["stereo"] = Stereo(baseline=5.0, toe_in=0.5 * (drawn["seed"] % 2))
    rows, columns = drawn["shape"]
    found = []
    for lens in range(drawn["lenses"]):
        camera = Camera(resolution=(columns, rows), pixel_pitch=0.05, aperture_diameter=drawn["aperture"] * 0.8**lens)
        found.append(Scene(camera=camera, objects=items, **sections))
    return found


def truth_of(drawn: Drawn) -> tuple[str, ...]:
    names = ALL_TRUTH
    few = {"one": 1, "some": 4}.get(drawn["truth"], 0)
    return names if drawn["truth"] == "all" else tuple(random.Random(drawn["seed"]).sample(names, few))


def plans_of(drawn: Drawn) -> list[Plan]:
    """Plans of the eyes of the first lens. Raises SceneError where a method cannot do the scene."""
    scene, device = scenes_of(drawn)[0], ThisMachine(kind=drawn["device"].get("kind", "cpu"))
    eyes: tuple[Eye, ...] = ("left", "right") if scene.stereo else ("left",)
    request = Request(truth_of(drawn), drawn["method"])
    return [plan_scene(scene, drawn["channels"], request, eye, depths_of(scene), device) for eye in eyes]


def features_of(drawn: Drawn) -> dict[str, Any]:
    """Features that decide what of the kernels is compiled and run, of all eyes."""
    found: dict[str, Any] = {"precision": drawn["precision"], "lenses": drawn["lenses"], "device": str(drawn["device"])}
    for plan in plans_of(drawn):
        fp64 = drawn["device"].get("has_fp64", True)
        prepare = plan.forward or plan.occlusion == "layered"
        found |= blur_features(plan.spec, plan.channels, fp64, "wide" if prepare else "none") | plan.features()
        found |= {"rooms": plan.spec.occluders, "blur": plan.blur, "occlusion": plan.occlusion}
        found |= {"truth": drawn["truth"], "general": plan.psf.signed, "rims": len(plan.psf.rims)}
        if plan.forward:
            found |= forward_features(plan, drawn["device"].get("kind") != "gpu") | {"samples": plan.samples}
    return found


def depths_of(scene: Scene) -> tuple[Array | None, ...]:
    """Inverse depth of a card, uneven and with nothing on its left, for every depth map."""
    assert scene.camera.resolution is not None
    columns, rows = scene.camera.resolution
    w = np.random.default_rng(43).uniform(1 / 262.0, 1 / 258.0, (rows, columns))
    w[:, : columns // 4] = 0.0
    return tuple(w if item.shape == "depth_map" else None for item in scene.objects)


def rendered(drawn: Drawn) -> list[Array]:
    """All images of the scenes; where textures and depth maps are read is patched by the caller."""
    options: Any = {"precision": drawn["precision"], "method": drawn["method"], "truth": truth_of(drawn)}
    found: list[Array] = []
    for _, frame in render_sweep(scenes_of(drawn), device="oclgrind", **options):
        found += [value for value in vars(frame).values() if isinstance(value, np.ndarray)]
    return found


def textures_of(scene: Scene, channels: int) -> tuple[Scene, tuple[Texture, ...]]:
    assert scene.camera.resolution is not None
    columns, rows = scene.camera.resolution
    shape = (rows, columns) if channels == 1 else (rows, columns, channels)
    rng, found = np.random.default_rng(41), []
    for k, item in enumerate(scene.objects):
        size = shape if item.mapped is None else (5, 7, *shape[2:])
        first, *others = (rng.random(size).astype(np.float32) for _ in item.textures())
        found.append(Texture(first, 8, str(k), others=tuple(others)))
    return scene, tuple(found)


def pairs_of(features: dict[str, Any]) -> set[Pair]:
    return set(combinations(sorted(features.items(), key=lambda item: item[0]), 2))


def cost(drawn: Drawn) -> float:
    """About how long it takes, in pixels: those of the padded grids, and as much as BUILD of them for each scene."""
    plans = plans_of(drawn)
    hard = HIDDEN * len(OBJECTS[drawn["objects"]]) if plans[0].occlusion == "visibility" else 1.0
    return BUILD + hard * drawn["lenses"] * sum(plan.height * plan.width * plan.samples for plan in plans)


def drawn_scenes() -> tuple[list[Drawn], int, int]:
    """The scenes, of how many that can be, and how many pairs of features they have."""
    rng = random.Random(SEED)
    known: list[tuple[Drawn, set[Pair], float]] = []
    while len(known) < DRAWN:
        drawn = {key: rng.choice(values) for key, values in CHOICES.items()}
        try:
            if (pixels := cost(drawn)) <= MOST:
                known.append((drawn, pairs_of(features_of(drawn)), pixels))
        except (SceneError, ValueError):
            continue
    wanted: set[Pair] = set().union(*(pairs for _, pairs, _ in known))
    count, taken = len(wanted), []
    while wanted:
        best = max(known, key=lambda one: len(one[1] & wanted) / one[2])
        taken.append(best[0])
        wanted -= best[1]
    return taken, len(known), count


def image_cases() -> Iterator[Case]:
    """`defocus` of images: each method with each PSF, 1 to 4 channels."""
    methods, edges = ("gather", "scatter", "tiles", "convolve"), ("integrated", "area", "sampled")
    keys: list[tuple[str, dict[str, Any]]] = [
        (method, {"model": model, "edge": edge, "occlusion": occlusion})
        for method, model, edge, occlusion in product(methods, ("pillbox", "gaussian"), edges, ("none", "layered"))
        if occlusion == "none" or not (method == "convolve" or edge == "area")
    ]
    keys += [(method, {"border": "renormalize", "occlusion": "none"}) for method in methods[:3]]
    for number, (method, psf) in enumerate(keys, 1):
        yield _image_case(number, method, Psf(**psf, tilt=number % 3 > 0))


def _image_case(number: int, method: str, psf: Psf) -> Case:
    rows, columns = SHAPES[number % len(SHAPES)]
    channels = number % 4 + 1
    rng = np.random.default_rng(number)
    image = rng.random((rows, columns, channels)).astype(np.float32) * (10.0 if number % 5 == 0 else 1.0)
    largest = 1.8 if method in ("tiles", "scatter") else 3.2
    coc = rng.choice([-1.0, 1.0], (rows, columns)) * rng.uniform(0.6, largest, (rows, columns))
    if method == "convolve":
        coc[:] = 1.9
    gpu = {} if method == "gather" else {"kind": "gpu"}  # whose kernels are made for processors
    changes: dict[str, Any] = ({}, gpu, {"has_fp64": False}, {"has_int64_atomics": False})[number % 4]
    about = f"{method}, {psf!r}, {rows} x {columns} x {channels}, {changes}"
    return Case(f"image {number}", changes, lambda: [blurred_image(image, coc, psf, method)], about)


def blurred_image(image: Array, coc: Array, psf: Psf, method: str) -> Array:
    """`clsco.defocus` with no apron, which a simulator would spend most of its time in."""
    return defocus(image, coc, psf, device="oclgrind", method=method, outside="black")


def inpainting_cases() -> Iterator[Case]:
    methods, shapes = ("mean-median", "biharmonic", "texture"), ((1, 2), (2, 9), (5, 4), (3, 5), (17, 1))
    for number, case in enumerate(product(methods, shapes, (True, False)), 1):
        yield _inpainting_case(number, *case)


def _inpainting_case(number: int, method: str, shape: tuple[int, int], codes: bool) -> Case:
    channels = number % 4 + 1
    rng = np.random.default_rng(number)
    image = (255 * rng.random((*shape, channels))).astype(np.uint8 if codes else np.float32)
    missing = rng.random(shape) < 0.3
    missing.flat[0], missing.flat[-1] = True, False
    changes: dict[str, Any] = {"kind": "gpu"} if number % 3 == 0 else {}
    about = f"{method} {shape} codes={codes} channels={channels} {changes}"
    return Case(
        f"inpainting {number}", changes, lambda: [inpaint(image, missing, method=method, device="oclgrind")], about
    )


def scene_cases() -> Iterator[Case]:
    for number, drawn in enumerate(drawn_scenes()[0]):
        yield Case(f"scene {number}", drawn["device"], partial(rendered, drawn), str(drawn), drawn["channels"])


def long_cases() -> Iterator[Case]:
    """Cases that small images have no need of: sums of wide discs, many missing pixels, runs amid a row."""
    rng = np.random.default_rng(11)
    image, coc = rng.random((5, 4)).astype(np.float32), np.full((5, 4), SUMMED + 2.0)
    holes = rng.random((10, 11, 1)).astype(np.float32)
    missing = np.zeros((10, 11), np.bool_)
    missing[2:8, 2:9] = True

    def summed(light: float) -> list[Array]:
        return [blurred_image(light * image, coc, Psf(), "convolve")]

    def filled(method: str) -> list[Array]:
        with patch("clsco.inpainting.mean_median.MOST_ENTRIES", 4):  # of a sweep that one work-group does
            return [inpaint(holes, missing, method=method, device="oclgrind")]

    for light in (1.0, 10.0):
        yield Case(f"sums, light {light}", {}, partial(summed, light))
    for method in ("mean-median", "biharmonic"):
        yield Case(f"many missing, {method}", {}, partial(filled, method))
    yield Case("many missing, as on a GPU", {"kind": "gpu"}, partial(filled, "mean-median"))
    yield Case("long rows", {}, layers_of_long_rows)
    for tilt in (True, False):
        yield Case(f"rows of discs, tilt {tilt}", {}, partial(discs, tilt))


def discs(tilt: bool) -> list[Array]:
    """Blur of three channels by sampled discs."""
    image, coc = np.ones((2, 9, 3), np.float32), np.linspace(8.0, 8.9, 18).reshape(2, 9)
    return [blurred_image(image, coc, Psf(edge="sampled", tilt=tilt, occlusion="none"), "gather")]


def layers_of_long_rows() -> list[Array]:
    """Runs at both ends of a row, and one amid it that looks for edges on both sides."""
    image, near = np.ones((6, 140), np.float32), np.arange(140) % 40 < 5
    psf = Psf(edge="sampled", tilt=False, occlusion="layered")
    coc = np.where(near, -0.6, 0.6) * np.ones((6, 1))
    return [blurred_image(image, coc, psf, "scatter")]


def sensor_cases() -> Iterator[Case]:
    """Sensors with and without a pattern, in color and with a mosaic; rows of whole vectors and of parts of them."""
    for number, sensor in enumerate((Sensor(prnu=0.0, dsnu=0.0), Sensor(hot_pixels=0.1), Sensor(mosaic="grbg"))):
        for channels in (1, 3):
            columns = (5, 16, 33)[(number + channels) % 3]
            gpu = {"kind": "gpu"} if channels == 3 else {}
            found = sensor_model(Scene(objects=(FAR,), sensor=sensor), channels)
            yield Case(f"sensor {number}, {channels} channels", gpu, partial(sensed, found, 3, columns), f"{sensor!r}")


def sensed(known: SensorModel, rows: int, columns: int) -> list[Array]:
    """Codes of light from none to twice the full well, which are those of the reference."""
    light = (np.random.default_rng(5).random((rows, columns, known.channels)) ** 4 * 2.4).astype(np.float32)
    session, pixels = (
        import_module("clsco.engine.sequence").session_for("oclgrind"),
        len(known.filters) * rows * padded_columns(columns),
    )
    plane = Plane2D(upload(session, flat(light, np.float32)), (known.channels, rows, columns), rows, columns)
    code = np.zeros((rows, columns, len(known.filters)), np.uint16)
    saturated = np.zeros(code.shape, np.bool_)
    sensor = FrameSensor(session, known, {"code": 2 * pixels, "saturated": pixels})
    sensor.expose(Strip(0, rows, 0, 0), plane, 3, []).read(session, code, saturated)
    wanted, full = sense(known, light, 3)
    assert (code == wanted).all()
    assert (saturated == full).all()
    return [code, saturated]


def lens_cases() -> Iterator[Case]:
    """Lenses that are not thin: each bend of the focus and both, light of each color by itself, vignetting."""
    bends: dict[str, dict[str, Any]] = {
        "field": {"field_curvature": -0.03, "vignetting": "natural"},
        "sphere": {"focus_surface": "sphere", "vignetting": (-0.3, 0.1, 0.0)},
        "image": {"distortion": (-0.25, 0.05, 0.0), "tangential": (0.01, -0.02)},
        "image and focus": {"distortion": (0.2, 0.1, 0.0), "field_curvature": -0.03, "focus_surface": "sphere"},
        "colors": {"field_curvature": -0.03, "focus_surface": "sphere", "axial": (0.2, 0.0, -0.1)},
        "ellipses by atomics": {"distortion": (-0.25, 0.05, 0.0)},
        "ellipses": {"distortion": (-0.25, 0.05, 0.0), "tangential": (0.01, -0.02)},
        "hidden ellipses by atomics": {"distortion": (0.2, 0.0, 0.0)},
        "hidden ellipses": {"distortion": (-0.25, 0.05, 0.0)},
    }
    for number, (name, keys) in enumerate(bends.items()):
        wall = Plane(distance=270.0, slope_x=0.5)
        wide: dict[str, Any] = {"pixel_pitch": 2.0, "aperture_diameter": 100.0} if "ellipses" in name else {}
        camera: dict[str, Any] = {"pixel_pitch": 0.3} | wide
        scene = Scene(camera=Camera(resolution=(9, 6), **camera), objects=(wall,), lens=Lens(**keys))
        if "hidden" in name:  # few pixels and sources: each has a test of all cells of a narrow lens
            ball = Sphere(center=(5.0, 3.0, 200.0), radius=40.0)
            camera |= {"resolution": (5, 4), "aperture_diameter": 160.0 if number % 2 == 0 else 100.0}
            psf = Psf(silhouette_samples=2)
            scene = Scene(camera=Camera(**camera), objects=(ball, wall), lens=Lens(**keys), psf=psf)
        kind = {"kind": "gpu"} if number % 2 else {}
        yield Case(f"lens, {name}", kind, partial(through_a_lens, scene), repr(scene.lens), 3)


def field_cases() -> Iterator[Case]:
    """Weights that are blended between those of places in the frame: of what is hidden in part, and of all methods."""
    seidel = Seidel(W131=0.3, W222=0.2)
    psf = Psf(seidel=seidel, wavelengths=(2500.0,) * 3, silhouette_samples=2)
    camera = Camera(resolution=(6, 4), pixel_pitch=0.05, aperture_diameter=1.2)
    for number, method in enumerate(("gather", "scatter", "tiles")):
        given = Scene(camera=camera, objects=(FAR,) if number else (BALL, FAR), psf=psf)
        yield Case(f"field, {method}", {}, partial(through_a_lens, given, method), repr(psf))


def through_a_lens(scene: Scene, method: str = "auto") -> list[Array]:
    """The image, and its radii."""
    ((_, frame),) = render_sweep((scene,), device="oclgrind", truth="blur_radius", method=method)
    assert frame.blur_radius is not None
    return [frame.color, frame.blur_radius]


def shared_cases() -> Iterator[Case]:
    """A fine texture in focus behind a wire far in front: the parts of a pixel share what hides the lens."""
    camera = Camera(resolution=(5, 4), pixel_pitch=0.1, aperture_diameter=20.0, focus_distance=250.0)
    image = np.random.default_rng(5).random((25, 40)).astype(np.float32)
    roof = Plane(distance=250.0, slope_x=0.2, texture=image, texture_mapping="surface", texture_size=(12.0,))
    wire = Cylinder(center=(-1.0, 0.0, 90.0), radius=0.35, axis=(0.3, 1.0, 0.0))
    scene = Scene(camera=camera, objects=(roof, wire), psf=Psf(silhouette_samples=2))
    assert plan_scene(scene, 1).features()["SHARED"]
    yield Case("shared", {}, partial(through_a_lens, scene))


def fault_cases() -> Iterator[Case]:
    """Cases that faults are planted in: few work-items, of which some have nothing to do."""
    rng = np.random.default_rng(7)
    image, codes = rng.random((3, 6, 2)).astype(np.float32), rng.random((6, 7, 1)).astype(np.float32)
    coc, jump = rng.uniform(0.9, 1.4, (3, 6)), np.where(np.arange(6) < 2, -2.0, 1.5) * np.ones((3, 1))
    missing = np.zeros((6, 7), np.bool_)
    missing[2:4, 2:5] = True

    def blurred(method: str, radii: Array, psf: Psf) -> Callable[[], list[Array]]:
        return lambda: [blurred_image(image, radii, psf, method)]

    yield Case("solver", {}, lambda: [inpaint(codes, missing, method="biharmonic", device="oclgrind")])
    yield Case("tiles", {}, blurred("tiles", coc, Psf(occlusion="none")))
    yield Case("layers", {}, blurred("scatter", jump, Psf(occlusion="layered")))


def all_cases() -> Iterator[Case]:
    yield from long_cases()
    yield from fault_cases()
    yield from sensor_cases()
    yield from lens_cases()
    yield from islice(field_cases(), EVERY > 1, None)  # the first takes minutes, as those of the next two functions
    if EVERY == 1:
        yield from shared_cases()
    for cases in (image_cases, inpainting_cases, scene_cases):
        yield from islice(cases(), 0, None, EVERY)
