"""Each kernel and each shared function of the device has its twin in NumPy, found by file and name."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
KERNELS = sorted((ROOT / "kernels").rglob("*.cl"))
# wide.clh makes of two floats what NumPy has as float64, angles.clh its functions; others are vectors of processors.
VECTORS = [
    f"{group}/{folder}{name}.clh"
    for group, name in (("common", "builtins"), ("common", "lanes"), ("inpainting", "lanes"))
    for folder in ("", "cpu/")
]
HEADERS = sorted(
    set((ROOT / "kernels").rglob("*.clh"))
    - {ROOT / "kernels" / name for name in ("common/wide.clh", "common/angles.clh", "common/cpu/pocl.clh", *VECTORS)}
)
# What has no twin of its own, and why.
WITHOUT_TWIN = {
    "trace": {
        "aim": "the rest of trace, for one of several lenses",
        "pinhole": "trace of all objects, with nothing in their way",
        "trace_detail": "part of trace_subpixels",
    },
    "visibility": {
        "dot3": "a product of NumPy's arrays",
        "size2": "np.hypot",
        "add_limit": "a row of _limits, which keeps infinite limits",
        "add_limits": "_limits",
    },
    "convolve": dict.fromkeys(("sum_down", "sum_across"), "sums over rectangles, of which the reference has no need"),
    "estimate": {"use_neighbors": "counts them, as the reference does where it needs to"},
    "sources": dict.fromkeys(("get_source", "put_source"), "where the planes of a record are"),
    "visibility_test": {"row_visibility": "finds out which vectors of taps need a test at all"},
    "psf": dict.fromkeys(
        ("pixel_spread", "subpixel_spread", "tap", "source_visibility"),
        "reads tables, in whose place the reference has the closed forms",
    ),
    "vectors": dict.fromkeys(("weights", "sums_of", "bits_of", "any_of"), "lanes of a vector"),
    "footprint": {
        "square_of": "two products",
        "place_of": "a few lines of mean_texture",
        "near_texel": "floats that are too large for an index are none in NumPy",
        "cubic_weights": "a few lines of add_texel",
        "detail_of": "parts_of",
    },
    "texture": dict.fromkeys(("texture_point", "radiance"), "parts of cast, for all pixels at once"),
    "geometry": {"note_radius": "the largest and the smallest of an array"},
    "warp": {"note_radii": "the largest and the smallest of an array"},
    "tiles": {"tiles": "the sum of scatter, which each tile forms for its pixels"},
    "many": dict.fromkeys(
        ["lowest_lane", "lowest", "some_taps", "values_at", "tap_weight", "take_sources", "ungrouped_of", "take_group"],
        "which sources of a row go together, and their weights",
    ),
    "rows": dict.fromkeys(
        ["tile_row", "take_row", "half_width_of"],
        "rows of sources at once, where scatter takes taps",
    ),
    "discs": dict.fromkeys(
        ["note_keys", "bounds_of", "finish_row", "ends_of", "add_row_ends", "add_row", "add_segment", "add_disc_rows"],
        "sums instead of taps",
    ),
    "near": dict.fromkeys(["add_near_taps", "finish_near_sums", "add_near_rows"], "the sum of scatter, row by row"),
    "quadrants": dict.fromkeys(
        (
            *("quadrant_column_of", "add_tap", "add_rim", "add_column_ends", "finish_quadrant_sums"),
            *("spread_quadrant_items", "put_quadrant_items"),
        ),
        "the sum of scatter, column by column",
    ),
    "gaussians": dict.fromkeys(
        ("axis_column_of", "add_block", "spread_axis_items", "weigh", "put_axis_items"), "one axis after the other"
    ),
    "columns": dict.fromkeys(["finish_tile", "add_columns"], "the sum of scatter, column by column"),
}

# Files whose twin is part of another file.
PART_OF = {"gather": "blur", "sources": "trace", "texture": "trace", "tiles": "blur"}
PART_OF |= dict.fromkeys(
    ("psf", "vectors", "many", "rows", "near", "discs", "quadrants", "gaussians", "columns"), "blur"
)


def kernel_names(text: str) -> set[str]:
    return set(re.findall(r"\b(?:__)?kernel\s+void\s+(\w+)\s*\(", plain(text)))


def inline_names(text: str) -> set[str]:
    return set(re.findall(r"\b(?:static|inline|INLINE)\s+[\w\s*]*?\b(\w+)\s*\(", plain(text)))


def plain(text: str) -> str:
    """The text without comments and attributes."""
    text = re.sub(r"//[^\n]*|/\*.*?\*/", " ", text, flags=re.DOTALL)
    return re.sub(r"__attribute__\s*\(\((?:[^()]|\([^()]*\))*\)\)", " ", text)


def twins(name: str) -> set[str]:
    (path,) = (ROOT / "clsco" / "reference").rglob(f"{name}.py")
    tree = ast.parse(path.read_text("utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_there_are_kernels() -> None:
    assert KERNELS


@pytest.mark.parametrize("path", KERNELS, ids=lambda path: path.name)
def test_each_kernel_has_its_twin(path: Path) -> None:
    names = kernel_names(path.read_text("utf-8"))
    assert names
    assert names - twins(PART_OF.get(path.stem, path.stem)) == WITHOUT_TWIN.get(path.stem, {}).keys()


@pytest.mark.parametrize("path", HEADERS, ids=lambda path: path.name)
def test_each_shared_function_has_its_twin(path: Path) -> None:
    names = inline_names(path.read_text("utf-8"))
    assert names
    assert names - twins(PART_OF.get(path.stem, path.stem)) == WITHOUT_TWIN.get(path.stem, {}).keys()


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
