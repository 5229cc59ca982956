"""Each kernel and each shared function of the device has its twin in NumPy: by file, name, and what functions take."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# The reference has all sources, also with a tolerance, and keeps nothing of a lens.
KERNELS = sorted(
    set((ROOT / "kernels").rglob("*.cl")) - {ROOT / "kernels" / f"trace/{name}.cl" for name in ("merge", "bend")}
)
# NumPy has what angles.clh has, clsco.optics.distortion what distortion.clh has, and the reference all sources at all
# time samples; others are vectors of processors.
VECTORS = [
    f"{group}/{folder}{name}.clh"
    for group, name in (("common", "builtins"), ("common", "lanes"), ("inpainting", "lanes"))
    for folder in ("", "cpu/")
]
HEADERS = sorted(
    set((ROOT / "kernels").rglob("*.clh"))
    - {
        ROOT / "kernels" / name
        for name in ("common/angles.clh", "common/distortion.clh", "common/cpu/pocl.clh", "trace/still.clh", *VECTORS)
    }
)
# What has no twin of its own, and why.
WITHOUT_TWIN = {
    "trace": {
        "aim": "part of trace, which casts for one lens",
        "label_subpixels": "part of trace_subpixels",
        "pinhole": "trace of all objects, with nothing in their way",
        "trace_detail": "part of trace_subpixels",
    },
    "noise": {"any_lane": "any of NumPy"},
    "blur": {"open_share": "_open_share of passes.py"},
    "visibility": {
        "dot3": "a product of NumPy's arrays",
        "size2": "np.hypot",
        "add_limit": "a row of _limits, which keeps infinite limits",
        "add_limits": "_limits",
    },
    "convolve": dict.fromkeys(("sum_down", "sum_across"), "sums over rectangles, of which the reference has no need"),
    "estimate": {"use_neighbors": "counts them, as the reference does where it needs to"},
    "sources": dict.fromkeys(("get_source", "put_source"), "where the planes of a record are"),
    "outline": {
        "with_limb": "the last lines of _covering",
        "has_one_label": "the same of eight pixels at once",
        "is_at_silhouette": "mark_silhouettes, for all pixels at once",
    },
    "occluder": dict.fromkeys(("limited_part", "inside_outline"), "a part of occluded_part"),
    "visibility_test": {
        "shared_cells": "free_share, which the device shortens where no two edges meet",
        "move_inwards": "the first lines of tap_share",
        "narrow_share": "the first lines of tap_share",
        "see_cells": "cell_visibility, before any tap",
        "weigh_cells": "the last lines of tap_share",
    },
    "psf": dict.fromkeys(
        ("pixel_spread", "subpixel_spread", "rim_of", "tap", "source_visibility"),
        "reads tables, in whose place the reference has the closed forms",
    )
    | dict.fromkeys(
        ("elliptic_spread", "below", "ellipse_margin", "rim_weight", "ellipse_weight", "point_weight", "with_ellipse"),
        "clsco.optics.ellipses",
    )
    | dict.fromkeys(("source_width", "light_of"), "of merged sources, as merge.cl")
    | dict.fromkeys(("pixel_visibility", "shared_visibility"), "_from_middles of trace.py")
    | {"find_cell": "SeidelField.blend, which the reference calls", "bend_visibility": "of visibility_test.py"},
    "vectors": dict.fromkeys(("weights", "sums_of", "any_of"), "lanes of a vector"),
    "footprint": {
        "square_of": "two products",
        "place_of": "a few lines of mean_texture",
        "near_texel": "floats that are too large for an index are none in NumPy",
        "cubic_weights": "the last lines of filter_weights",
        "add_weights": "filter_weights, which are added by its caller",
        "piece_weights": "two lines of taps_of",
        "few_taps_of": "taps_of, which leaves arrays in registers",
        "add_few_texels": "add_texels, which reads rows as vectors",
        "cell_width": "one line of mean_texture",
        "detail_of": "parts_of",
    },
    "texture": dict.fromkeys(("texture_point", "radiance"), "parts of cast, for all pixels at once"),
    "geometry": {
        "note_radius": "the largest and the smallest of an array",
        "ray_through": "pixel_ray before another lens",
        "ray_change": "ray_changes of clsco.optics.rays, times px",
        "lens_along": "along_rays",
        "bent_radius": "blur_radius, once what a ray has to do with it is known",
        "grid_radius": "blur_radius of all pixels",
        "grid_ray": "pixel_ray of the rows and columns of the padded grid",
        **dict.fromkeys(("load3", "row3", "column3", "inner_product"), "arrays of NumPy, and their products"),
    },
    "warp": {"note_radii": "the largest and the smallest of an array"},
    "tiles": {"tiles": "the sum of scatter, which each tile forms for its pixels"},
    "many": dict.fromkeys(
        [
            "lowest_lane",
            "lowest",
            "few_taps",
            "some_taps",
            "values_at",
            "tap_weight",
            "ellipse_sizes",
            "take_sources",
            "ungrouped_of",
            "take_group",
        ],
        "which sources of a row go together, and their weights",
    ),
    "discs": dict.fromkeys(
        [
            "tile_row",
            "take_row",
            "half_width_of",
            "note_keys",
            "bounds_of",
            "finish_row",
            "ends_of",
            "add_row_ends",
            "add_row",
            "add_segment",
            "add_disc_rows",
        ],
        "sums instead of taps",
    ),
    "quadrants": dict.fromkeys(
        (
            *("quadrant_column_of", "add_tap", "add_rim", "add_rims", "add_column_ends", "finish_quadrant_sums"),
            *("spread_quadrant_items", "put_quadrant_items"),
        ),
        "the sum of scatter, column by column",
    ),
    "ellipses": dict.fromkeys(
        (
            *("ellipse_column_of", "wide_sqrt", "floor_of_lowest", "add_chord_ends", "add_chords", "finish_chords"),
            *("spread_ellipse_items", "put_ellipse_items"),
        ),
        "the sum of scatter, column by column",
    ),
    "cut": dict.fromkeys(
        (
            *("lowest_of", "cut_share", "add_cut_taps", "add_cut_ends", "finish_cut_sums", "cut_rows"),
            *("spread_cut_items", "put_cut_items"),
        ),
        "the sum of scatter, column by column",
    ),
    "shapes": dict.fromkeys(
        (
            *("shape_column_of", "add_shape_taps", "add_shape_ends", "finish_shape_sums"),
            *("spread_shape_items", "put_shape_items"),
        ),
        "the sum of scatter, column by column",
    ),
    "gaussians": dict.fromkeys(
        ("axis_column_of", "add_block", "spread_axis_items", "weigh", "put_axis_items"), "one axis after the other"
    ),
    "spans": dict.fromkeys(
        ("rims_of", "add_ends", "finish_spans", "bits_between", "tap_at", "add_spans"), "runs of taps instead of taps"
    ),
    "blocks": dict.fromkeys(
        (
            *("least_of_corners", "most_of_corners", "add_conics", "find_conics", "sign_around"),
            *("classify_limited", "classify_blocks", "edges_in_block", "share_of_edges", "find_rims"),
        ),
        "finds out which taps need a test at all",
    ),
    "columns": dict.fromkeys(["finish_tile", "add_columns"], "the sum of scatter, column by column"),
}

# Parameters that the twin of a function calls otherwise, or has in one record.
SYNONYMS = {
    "s": "surface", "ray": "rays", "whole_ray": "rays", "D": "d", "m": "matrix", "v": "vector", "n": "normal",
    "map": "texture_map texture", "object": "number", "point_w": "position", "grid": "camera",
}  # fmt: skip
RECORDS = {"points": ["ray", "w"], "texture": ["texture", "map"]}
ON_THE_DEVICE = {"bounds", "texture_filter", "waves"}  # in surface_t, and features
# Functions that take other things than their twins, and why.
OTHERWISE = {
    "crossing_part": "the device is told which conditions may decide on part of a cell",
    "quarter_discriminant": "A and B are needed as well, and linear terms seldom",
    "blur_gradient": "the device is told what the lens does to a ray",
    "table_coordinate": "psf_t has the range of the table",
    "hides_all": "conditions of an occluder_t are dropped in place",
    "keep_equation": "fields of an occluder_t are filled one after the other",
    "flatten_limits": "limits of an occluder_t are changed in place",
    "division_of": "records of sources hold the gradient over the radius",
    "free_share": "the device is told where no two edges meet",
    "lens_share": "the device is told where no two edges meet",
    "meet_rims": "one source after the other",
    "check_visibility": "its caller divides the lens, by the radius that it has already",
    "cell_visibility": "one cell after the other, given by its middle",
    "estimate": "settings of all lanes are in an around_t",
    "detailed_texture": "FINE and SUBPIXELS are features",
    "sample_texture": "grid_t has the size of the texture, and margins are left out",
    "add_texels": "rows before columns, as taps; a size is that of the array",
    "footprint_of": "what changes from part to part, right and down, is one argument",
    "mean_texture": "a side of a cube map is part of its texel",
    "on_side": "of a change",
    "texels_of": "one axis after the other",
    "laplacian": "pixel by pixel, of an image or a vector",
    "outside_frame": "column and row are in one vector",
    "labels_around": "all pixels at once",
    "is_at_limb": "SUBPIXELS is a feature",
    "passes_between": "the device has the ray through the middle",
    "share_square": "a coverage_t is changed in place",
    "place_of_source": "one cell after the other, given by its label",
    "project": "a camera of another time has another slope between rays",
    "occluded_among": "objects and their bounds are in surface_t",
}

# Files whose twin is part of another file.
PART_OF = {"gather": "blur", "sources": "trace", "texture": "trace", "tiles": "blur"}
PART_OF |= dict.fromkeys(("psf", "vectors", "many", "discs", "quadrants", "cut", "shapes", "ellipses"), "blur")
PART_OF |= dict.fromkeys(("gaussians", "columns", "spans"), "blur")
PART_OF |= {"blocks": "visibility_test"}


def kernel_names(text: str) -> set[str]:
    return set(re.findall(r"\b(?:__)?kernel\s+void\s+(\w+)\s*\(", plain(text)))


def inline_names(text: str) -> set[str]:
    return set(re.findall(r"\b(?:static|inline|INLINE)\s+[\w\s*]*?\b(\w+)\s*\(", plain(text)))


def plain(text: str) -> str:
    """The text without comments and attributes."""
    text = re.sub(r"//[^\n]*|/\*.*?\*/", " ", text, flags=re.DOTALL)
    return re.sub(r"__attribute__\s*\(\((?:[^()]|\([^()]*\))*\)\)", " ", text)


def twins(path: Path) -> dict[str, ast.FunctionDef]:
    (twin,) = (ROOT / "clsco" / "reference").rglob(f"{PART_OF.get(path.stem, path.stem)}.py")
    tree = ast.parse(twin.read_text("utf-8"))
    return {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}


def taken(text: str) -> dict[str, list[str]]:
    """Names of what the functions of a device take: by value, or to be read only."""
    found = {}
    heads = r"\b(?:static|inline|INLINE)\s+[\w\s*]*?\b(\w+)\s*\(([^()]*)\)\s*\{"
    for name, parameters in re.findall(heads, plain(text)):
        read = [one for one in parameters.split(",") if "const" in one or not re.search(r"[*\[]", one)]
        found[name] = [re.findall(r"\w+", one)[-1] for one in read if one.strip()]
    return found


def matches(taken: list[str], function: ast.FunctionDef) -> bool:
    """True if a function of the device takes what its twin takes, in the same order."""
    names = [one.arg for one in (*function.args.args, *function.args.kwonlyargs) if one.arg not in ON_THE_DEVICE]
    for name in names:
        record = RECORDS.get(name, [])
        if record and taken[:1] == record[:1] and set(record) <= set(taken):
            taken = [one for one in taken if one not in record]
        elif taken and name in (taken[0], *SYNONYMS.get(taken[0], "").split()):
            taken = taken[1:]
        else:
            return False
    return not taken


def test_there_are_kernels() -> None:
    assert KERNELS


@pytest.mark.parametrize("path", KERNELS, ids=lambda path: path.name)
def test_each_kernel_has_its_twin(path: Path) -> None:
    names = kernel_names(path.read_text("utf-8"))
    assert names
    assert names - twins(path).keys() == WITHOUT_TWIN.get(path.stem, {}).keys()


@pytest.mark.parametrize("path", HEADERS, ids=lambda path: path.name)
def test_each_shared_function_has_its_twin(path: Path) -> None:
    names = inline_names(path.read_text("utf-8"))
    assert names
    assert names - twins(path).keys() == WITHOUT_TWIN.get(path.stem, {}).keys()


def test_functions_take_what_their_twins_take() -> None:
    pairs = {
        name: matches(parameters, twins(path)[name])
        for path in (*KERNELS, *HEADERS)
        for name, parameters in taken(path.read_text("utf-8")).items()
        if name in twins(path)
    }
    assert len(pairs) > 60
    assert {name for name, alike in pairs.items() if not alike} == OTHERWISE.keys()


@pytest.mark.parametrize(
    ("device", "twin", "alike"),
    [
        ("static real f(const lens_t lens, real3 ray, real w, real *out) {", "lens, rays, w", True),
        ("INLINE int f(__constant surface_t *s, real w) {", "surface, bounds, w", True),
        ("static int f(real3 ray, real w, real x) {", "points, x", True),
        ("static int f(__global const float *at, real w) {", "w, at", False),
        ("static int f(real w, real x) {", "w", False),
        ("static int f(real w) {", "w, x", False),
    ],
)
def test_what_functions_take_is_compared(device: str, twin: str, alike: bool) -> None:
    (node,) = ast.parse(f"def f({twin}): ...").body
    assert isinstance(node, ast.FunctionDef)
    assert matches(taken(device)["f"], node) == alike


def test_names_are_found_in_any_dress() -> None:
    text = """
    /* __kernel void not_this(int n) */ // kernel void nor_this(int n)
    __kernel void one(int n) { }
    __kernel __attribute__((reqd_work_group_size(1, 1, 1)))
    void two (int n) { }
    kernel void __attribute__((vec_type_hint(float4))) three(int n) { }
    inline real four(real x) { return five(x); }
    static inline __global const real *six(real2 x) { return 0; }
    real seven(real x) { return x; }
    static int eight(real x) { return 0; }
    #define INLINE static inline __attribute__((always_inline))
    #if 1
    INLINE lanes_t nine(lanes_t x)
    #endif
    """
    assert kernel_names(text) == {"one", "two", "three"}
    assert inline_names(text) == {"four", "six", "eight", "nine"}
