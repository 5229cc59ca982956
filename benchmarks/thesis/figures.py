"""The figures of the thesis: the scenes that make them, the numbers that it states, and how these are measured.

Figures are rows of `FIGURES`, numbers rows of `NUMBERS`; scenes are files of `examples/thesis`, by their stems.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from clsco.frame.frame import Frame
from clsco.inpainting.rules import MeanMedian
from clsco.scene.model import Scene

TRUTH = ("depth", "blur_radius", "missing", "mask", "object_id", "normal", "flow")  # what numbers are measured in


@dataclass(frozen=True)
class RenderedScene:
    """A scene with its frames, which have `TRUTH`, and `subframes` where a figure shows them."""

    scene: Scene
    frames: tuple[Frame, ...]

    def of_surface(self, name: str) -> NDArray[Any]:
        """The values of an output of the first frame where there is a surface."""
        found: NDArray[Any] = getattr(self.frames[0], name)[self.frames[0].mask]
        return found

    def samples(self) -> list[dict[str, Any]]:
        """Records of all time samples of all frames."""
        return [sample for frame in self.frames for sample in frame.metadata["intermediate"]]


Measure = Callable[..., float]  # of a scene that is made, or where there is none of nothing


@dataclass(frozen=True)
class Figure:
    """A figure of the thesis.

    Attributes
    ----------
    number : str
    shows : str
    pictures : tuple of str
        Files in the folder of the command, in the order of the figure.
    chosen : str
        Choices that the thesis does not state.
    is_sized : bool
        True if the thesis states all that its numbers depend on.
    """

    number: str
    shows: str
    pictures: tuple[str, ...]
    chosen: str = ""
    is_sized: bool = True

    @property
    def scenes(self) -> tuple[str, ...]:
        """Scenes whose frames the figure shows."""
        return tuple(dict.fromkeys(picture.partition("/")[0] for picture in self.pictures))


@dataclass(frozen=True)
class Number:
    """A number of a figure, or of a section of the text.

    Attributes
    ----------
    figure : str
    what : str
        With its unit.
    stated : str
        By the thesis, "" where it states none.
    scenes : tuple of str
        Scenes that it is measured in; none for a default of clsco.
    measure : callable
        Measures it in a `RenderedScene`; of several scenes the largest counts.
    digits : int
        Decimals that are shown.
    most : float, optional
        Up to which a stated bound holds, "at most about 6" up to 6.5; by default the number must agree in the digits
        that are stated.
    note : str
    is_input : bool
        It is given to clsco, and not measured.
    """

    figure: str
    what: str
    stated: str
    scenes: tuple[str, ...]
    measure: Measure
    digits: int = 0
    most: float | None = None
    note: str = ""
    is_input: bool = False

    def agrees(self, got: float) -> bool:
        """True if a measured value agrees with the stated one."""
        if self.most is not None:
            return got <= self.most
        decimals = len(self.stated.partition(".")[2])
        return abs(got - float(self.stated)) <= 0.5 * 10.0**-decimals


def _frame(scene: str, number: int = 0) -> str:
    return f"{scene}/frame_{number:04d}.png"


def _subframe(scene: str, number: int) -> str:
    """Path of a sub-frame; each frame has five, and they are counted through all frames."""
    return f"{scene}/frame_{number // 5:04d}_sample_{number % 5:02d}.png"


def _missing(scene: str) -> str:
    return f"{scene}/missing.png"


def _slope(axis: int) -> Measure:
    """Slope of a plane along x (0) or y (1), from its normals."""

    def measure(made: RenderedScene) -> float:
        normal = made.of_surface("normal")
        return float(np.mean(normal[:, axis] / -normal[:, 2]))

    return measure


def _spread(name: str, axis: int | None = None) -> Measure:
    """By how much an output differs at most within a frame, or within its rows (1) or columns (0)."""
    return lambda made: float(np.ptp(getattr(made.frames[0], name), axis=(0, 1) if axis is None else axis).max())


def _focused_depth(made: RenderedScene) -> float:
    """Depth at which R is 0: R is linear in inverse depth (2.33)."""
    slope, offset = np.polyfit(1.0 / made.of_surface("depth").astype(np.float64), made.of_surface("blur_radius"), 1)
    return float(-slope / offset)


def _largest_blur(made: RenderedScene) -> float:
    return float(np.abs(made.of_surface("blur_radius")).max())


def _middle_blur(made: RenderedScene) -> float:
    radius = made.frames[0].blur_radius
    assert radius is not None
    return float(np.abs(radius[tuple(n // 2 for n in radius.shape)]))


def _diagonal_blur(made: RenderedScene) -> float:
    radius = made.frames[0].blur_radius
    assert radius is not None
    return float(np.abs(np.diagonal(radius)).max())


def _displacement(name: str) -> Measure:
    """Length of the flow of an object, px."""

    def measure(made: RenderedScene) -> float:
        frame, (number,) = made.frames[0], [k for k, item in enumerate(made.scene.objects) if item.name == name]
        assert frame.flow is not None
        return float(np.linalg.norm(frame.flow[frame.object_id == number], axis=-1).mean())

    return measure


def _step(made: RenderedScene) -> float:
    """Time between time samples, s."""
    return float(np.mean(np.diff([sample["time"] for sample in made.samples()])))


def _turn(made: RenderedScene) -> float:
    """Angle about y between time samples, deg."""
    return _step(made) * made.scene.objects[0].motion.angular_velocity[1]


def _of_samples(name: str) -> Measure:
    """A count that is recorded of time samples, of all of them."""
    return lambda made: sum(sample[name] for sample in made.samples())


def _missing_pixels(made: RenderedScene) -> float:
    return float(union_of_missing(made.frames).sum())


def _grazing_angle(made: RenderedScene) -> float:
    """Angle between the optical axis and a plane, deg."""
    return float(np.degrees(np.arcsin(np.abs(made.of_surface("normal")[:, 2]).mean())))


def union_of_missing(frames: tuple[Frame, ...]) -> NDArray[np.bool_]:
    """Pixels (rows, columns) that are missing in any time sample of any frame."""
    masks = [frame.missing for frame in frames if frame.missing is not None]
    return np.logical_or.reduce(masks)


def _before(number: str, shows: str, rest: str, moved: str, chosen: str = "", is_sized: bool = True) -> Figure:
    """A figure of an object at rest, moved with missing pixels, and their mask."""
    pictures = (_frame(rest), _frame(moved), _missing(moved))
    return Figure(number, f"{shows}: before, after, what is missing", pictures, chosen, is_sized)


SPHERE = "center at 280 mm, radius 30 mm"
CYLINDER = "center at 280 mm, radius 30 mm"
CONE = "apex at 250 mm, half angle 50 deg"
ELLIPSOID = "center at 300 mm, semi-axes 30, 30 and 50 mm"
CENTERS = "centers at 250, 265 and 300 mm, radius 30 mm"
TOWARDS = "10 mm are taken towards the lens, as in 4.9"
MOVED = "turned by {} deg about {} and moved by 10 mm"
ABOVE = "camera straight above the road, at 250 mm"
ROAD = "the axis meets the road at 250 mm; 5 mm/s"

FIGURES = (
    Figure("3.3", "test image", (_frame("fig_3_03"),), "drawn bricks for the photograph, which is not available"),
    Figure("3.4", "plane: out of focus; tilted", (_frame("fig_3_04_left"), _frame("fig_3_04_right")), "PSF: Gaussian"),
    Figure("3.5", "plane, tilted", (_frame("fig_3_05_left"), _frame("fig_3_05_right")), "PSF: Gaussian"),
    Figure("3.8", "cylinder: pillbox; Gaussian", (_frame("fig_3_08_left"), _frame("fig_3_08_right")), CYLINDER, False),
    Figure("3.9", "cylinder at three distances", tuple(_frame(f"fig_3_09_{n}") for n in "abc"), CENTERS, False),
    Figure("3.12", "sphere: pillbox; Gaussian", (_frame("fig_3_12_left"), _frame("fig_3_12_right")), SPHERE, False),
    Figure("3.13", "sphere at three distances", tuple(_frame(f"fig_3_13_{n}") for n in "abc"), CENTERS, False),
    Figure("3.15", "cone: pillbox; Gaussian", (_frame("fig_3_15_left"), _frame("fig_3_15_right")), CONE, False),
    Figure(
        "3.17", "ellipsoid: pillbox; Gaussian", (_frame("fig_3_17_left"), _frame("fig_3_17_right")), ELLIPSOID, False
    ),
    Figure("4.2", "plane moving in x", (_frame("fig_4_02"),), "at 250 mm, 2 mm/s", False),
    Figure("4.3", "sphere moving in x", (_frame("fig_4_03"),), f"{SPHERE}, 2 mm/s", False),
    Figure("4.4", "sub-frames 1 to 6", tuple(_subframe("fig_4_06", n) for n in range(6)), SPHERE, False),
    Figure("4.5", "sub-frames 7 to 15", tuple(_subframe("fig_4_06", n) for n in range(6, 15)), SPHERE, False),
    Figure("4.6", "three video frames", tuple(_frame("fig_4_06", n) for n in range(3)), SPHERE, False),
    Figure("4.7", "what is missing in 4.4 to 4.6", (_missing("fig_4_06"),), SPHERE, False),
    _before("4.8", "sphere turned by 45 deg about x", "fig_3_12_right", "fig_4_08", SPHERE, False),
    _before("4.9", "plane moved from 250 to 240 mm", "fig_3_03", "fig_4_09"),
    _before("4.10", "plane turned by 45 deg about z", "fig_3_03", "fig_4_10"),
    _before("4.11", f"cylinder {MOVED.format(30, 'z')}", "fig_3_08_right", "fig_4_11", f"{CYLINDER}; {TOWARDS}", False),
    _before("4.12", f"cone {MOVED.format(20, 'x')}", "fig_3_15_right", "fig_4_12", f"{CONE}; {TOWARDS}", False),
    Figure("4.13", "4.8 filled", (_frame("fig_4_13"),), SPHERE, False),
    Figure("4.14", "4.9 filled", (_frame("fig_4_14"),)),
    Figure("4.15", "4.10 filled", (_frame("fig_4_15"),)),
    Figure("4.16", "4.11 filled", (_frame("fig_4_16"),), f"{CYLINDER}; {TOWARDS}", False),
    Figure("4.17", "4.12 filled", (_frame("fig_4_17"),), f"{CONE}; {TOWARDS}", False),
    Figure(
        "4.18", "road from above; five sub-frames of the car's camera",
        (_frame("fig_4_18"), *(_subframe("fig_4_19", n) for n in range(5))), f"{ABOVE}; {ROAD}", False,
    ),
    Figure("4.19", "the frame of the car's camera", (_frame("fig_4_19"),), ROAD, False),
)  # fmt: skip

# Figures that nothing renders, and why.
OTHERS = (
    ("2.1 to 2.3, 3.1, 3.2, 3.6, 3.7, 3.10, 3.11, 3.14, 3.16, 4.1, 5.2", "drawings"),
    ("5.1, 5.3 to 5.21", "photographs that are not available; `clsco inpaint --method mean-median` is their method"),
    ("6.1", "the window of SCO-3D"),
)

AWAY = "the caption's 10 mm away from the lens are 10 mm towards it: away from it nothing is missing"
WIDE = "the caption's slopes exceed it"
FILLED = (
    ("4.8", "4.13", "68804"), ("4.9", "4.14", "19680"), ("4.10", "4.15", "36993"), ("4.11", "4.16", "36784"),
    ("4.12", "4.17", "26122"),
)  # fmt: skip
CHOSEN_BLUR = tuple(
    f"fig_3_{end}"
    for end in (
        "08_left", "09_a", "09_b", "09_c", "12_left", "13_a", "13_b", "13_c", "15_left", "17_left",
    )
)  # fmt: skip
IN_FOCUS = ("fig_3_08_left", "fig_3_12_left", "fig_3_15_left", "fig_3_17_left")


def _input(
    figure: str, what: str, stated: str, scene: str, measure: Measure, digits: int = 0, note: str = ""
) -> Number:  # fmt: skip
    """A number that a scene, or without one a default, has as it is stated."""
    return Number(figure, what, stated, (scene,) * bool(scene), measure, digits, note=note, is_input=True)


def _camera(name: str, stated: str, digits: int, unit: str = "mm") -> Number:
    what = f"{name.replace('_', ' ')}, {unit}"
    return _input("3.3", what, stated, "fig_3_03", lambda made: getattr(made.scene.camera, name), digits)


def _filling(before: str, after: str, stated: str) -> tuple[Number, ...]:
    """Numbers on a figure with missing pixels, and on another one where they are filled."""
    missing, filled = ((f"fig_4_{int(number[2:]):02d}",) for number in (before, after))
    note = AWAY if after == "4.14" else ""
    return (
        Number(before, "missing pixels", "", missing, _missing_pixels),
        Number(after, "filled in the first sweep", stated, filled, _of_samples("filled_first_sweep"), note=note),
        Number(after, "sweeps", "one, rarely two", filled, _of_samples("sweeps"), most=2.0),
        Number(after, "left missing", "0", filled, _of_samples("unfilled_pixels")),
    )


def _blur(figure: str, what: str, scenes: tuple[str, ...], note: str = "") -> Number:
    """The largest blur radius, of which the thesis states a bound."""
    return Number(figure, what, "at most about 6", scenes, _largest_blur, 2, 6.5, note)


NUMBERS = (
    _camera("focal_length", "20.0", 1),
    _camera("aperture_diameter", "10.0", 1),
    _camera("pixel_pitch", "0.01", 2),
    _camera("sensor_distance", "21.739", 3),
    _camera("normalization_distance", "20.0", 1),
    Number("3.3", "distance in focus, mm", "250", ("fig_3_04_right",), _focused_depth, 3),
    _input(
        "3.4", "sigma / R", "0.707", "fig_3_04_left", lambda made: made.scene.psf.sigma_ratio, 3,
        note="1 / sqrt(2) by (2.29); (3.3) has the square root the other way round, a misprint",
    ),
    _input("3.4", "cut of the Gaussian, sigma", "2", "fig_3_04_left", lambda made: made.scene.psf.truncation),
    Number("3.4", "left: distance, mm", "230", ("fig_3_04_left",), lambda made: float(made.of_surface("depth").mean())),
    Number("3.4", "left: R differs by, px", "0", ("fig_3_04_left",), _spread("blur_radius"), 2),
    _blur("3.4", "left: largest blur radius, px", ("fig_3_04_left",)),
    Number("3.4", "right: slope along x", "1.5", ("fig_3_04_right",), _slope(0), 2, note="along y in the caption"),
    Number("3.4", "right: R differs along y by, px", "0", ("fig_3_04_right",), _spread("blur_radius", 0), 2),
    _blur("3.4", "right: largest blur radius, px", ("fig_3_04_right",), WIDE),
    Number("3.5", "left: slope along y", "0.7", ("fig_3_05_left",), _slope(1), 2, note="along x in the caption"),
    Number("3.5", "left: R differs along x by, px", "0", ("fig_3_05_left",), _spread("blur_radius", 1), 2),
    _blur("3.5", "left: largest blur radius, px", ("fig_3_05_left",)),
    Number("3.5", "right: slope along x", "1", ("fig_3_05_right",), _slope(0), 2),
    Number("3.5", "right: slope along y", "1", ("fig_3_05_right",), _slope(1), 2),
    Number("3.5", "right: R on the main diagonal, px", "0", ("fig_3_05_right",), _diagonal_blur, 2),
    _blur("3.5", "right: largest blur radius, px", ("fig_3_05_right",), WIDE),
    _blur("3.8 to 3.17", "largest blur radius, px", CHOSEN_BLUR, "sizes chosen so"),
    Number("3.8 to 3.17", "R in the middle, px", "0", IN_FOCUS, _middle_blur, 2, note="distances chosen so"),
    _input("4.2", "sub-frames", "5", "fig_4_02", lambda made: len(made.samples())),
    Number("4.2", "displacement differs by, px", "0", ("fig_4_02",), _spread("flow"), 2),
    _input("4.3", "sub-frames", "5", "fig_4_03", lambda made: len(made.samples())),
    Number("section 4.3.3", "10 mm at 250 mm, px", "80", ("section_4_3_3",), _displacement("near"), 2),
    Number("section 4.3.3", "10 mm at 285 mm, px", "70", ("section_4_3_3",), _displacement("far"), 2),
    _input("4.4, 4.5", "sub-frames", "15", "fig_4_06", lambda made: len(made.samples())),
    _input("4.4, 4.5", "between them, s", "0.2", "fig_4_06", _step, 2),
    _input("4.4, 4.5", "between them, deg", "1", "fig_4_06", _turn, 2),
    _input("4.6", "video frames", "3", "fig_4_06", lambda made: len(made.frames)),
    Number("4.7", "missing pixels, all together", "", ("fig_4_06",), _missing_pixels),
    *(number for row in FILLED for number in _filling(*row)),
    _input("4.18", "sub-frames", "5", "fig_4_19", lambda made: len(made.samples())),
    Number("4.19", "optical axis to road, deg", "30", ("fig_4_19",), _grazing_angle, 2),
    _input("section 5.3.1", "known neighbors a pixel needs", "4", "", lambda: MeanMedian().minimum),
    _input("section 5.3.2", "rounds of the median", "20", "", lambda: MeanMedian().smoothing_rounds),
    _input("section 5.3.3", "share of the border that is blended", "0.4", "", lambda: MeanMedian().border_share, 1),
)  # fmt: skip


def numbers_named(text: str) -> list[str]:
    """Figures that a row of numbers is of: "4.4, 4.5" are two, "3.8 to 3.17" the first and the last and all between."""
    if " to " not in text:
        return text.removeprefix("section ").split(", ")
    first, last = (_order(end) for end in text.split(" to "))
    return [figure.number for figure in FIGURES if first <= _order(figure.number) <= last]


def _order(number: str) -> tuple[int, ...]:
    return tuple(int(part) for part in number.split("."))


def chosen(wanted: Sequence[str]) -> tuple[tuple[Figure, ...], tuple[Number, ...]]:
    """Rows of figures and numbers, all without a name. Raises click.UsageError for any other name."""
    known = dict.fromkeys([figure.number for figure in FIGURES])
    known |= dict.fromkeys(name for number in NUMBERS for name in numbers_named(number.figure))
    for name in wanted:
        if name not in known:
            raise click.UsageError(f"--only: must be one of {', '.join(sorted(known, key=_order))}; got {name}")
    if not wanted:
        return FIGURES, NUMBERS
    return (
        tuple(figure for figure in FIGURES if figure.number in wanted),
        tuple(number for number in NUMBERS if set(numbers_named(number.figure)) & set(wanted)),
    )
