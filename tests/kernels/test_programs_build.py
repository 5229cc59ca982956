"""Every kernel file builds with every feature on, with none, and with each one the other way, on any device."""

from __future__ import annotations

import re
from collections import ChainMap
from dataclasses import replace
from pathlib import Path

import pytest

from clsco.inpainting.mean_median import KERNELS as HOLES
from clsco.opencl.features import FEATURES
from clsco.opencl.program import BUILTINS, POCL_DECLARATIONS, build
from clsco.opencl.session import Kernels, Session
from clsco.passes.blur import FILES_OF, blur_features
from clsco.passes.trace import TRACE_FILES
from clsco.passes.warp import KERNELS as FORWARD
from clsco.passes.warp import forward_features
from clsco.records import Real, structs
from clsco.scene.model import Psf, Sphere
from tests.scenes import plan_of
from tests.spreads import spec_of

KERNELS = Path(__file__).resolve().parents[2] / "kernels"
ON_OR_OFF: tuple[int, ...] = (0, 1)
GEOMETRY: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("SEVERAL", "QUADRATIC", "LINEAR", "NAPPE", "BOUNDED", "SAMPLED"), ON_OR_OFF),
    "CURVED": (0, 3, 1, 2, 4, 7),
    "GENERAL": (0,),
    "WAVES": (0,),
    "CHANNELS": (1, 3),
    "FILTER": (0, 2, 1),
}
# Not with what is alike in all octants.
GENERAL = {"GENERAL": (0, 0, 1), "EDGES": (0, 0, 6), "WAVES": (0, 0, 1), "FIELD": (0, 0, 1)}
BLUR = dict.fromkeys(("SAMPLED", "TILT", "GATHER", "SCATTER", "RENORMALIZE", "DISC", "SEPARABLE", "LIMITED"), ON_OR_OFF)
BLUR |= {"CHANNELS": (1, 3), "SUBPIXELS": (0, 4, 2, 3), "CURVED": (0, 3, 1, 2, 4, 7), "PREPARE": (0, 1, 2)}
BLUR |= {"OCCLUDED": (0, 4, 1, 63), "RIMS": (0, 2), "CUT_CHORDS": (0, 1, 2), "BORDERS": ON_OR_OFF, **GENERAL}
BLUR |= {"SHARED": ON_OR_OFF, "RAYS": ON_OR_OFF}
GATHER, SCATTER, TILES = (FILES_OF[method] for method in ("gather", "scatter", "tiles"))
LAYERED = ("layered/layered.cl", "layered/sheets.cl")
# Files that are used together: feature -> value when off, when on, and others. Structure is all that is compiled in.
PROGRAMS: dict[tuple[str, ...], dict[str, tuple[int, ...]]] = {
    TRACE_FILES: GEOMETRY
    | dict.fromkeys(("MOVED", "TILT", "OCCLUDED", "LIMITED", "GATHER"), ON_OR_OFF)
    | {"SUBPIXELS": (0, 4, 2, 3), "TEXTURED": (0, 2, 1), "LIT": (0, 1, 3), "EDGES": (0,), "RIMS": (0, 2), "RAYS": (0,)}
    | {"CUT_CHORDS": ON_OR_OFF, "BORDERS": ON_OR_OFF, "SMALL": ON_OR_OFF, "WAVES": (0, 0, 1)}
    | {"ELLIPSES": ON_OR_OFF, "SHARED": ON_OR_OFF},
    GATHER: BLUR
    | {"BY_COLUMNS": ON_OR_OFF, "GATHER": (1,), "SPANS": ON_OR_OFF, "RING": (0, 0, 1), "ELLIPSES": (0, 0, 1)}
    | {"SEPARABLE": (0, 0, 1)},
    SCATTER: BLUR | dict.fromkeys(("GATHER", "BY_COLUMNS", "RING"), (0,)) | {"ELLIPSES": ON_OR_OFF},
    ("blur/accumulate.cl",): {"SCAN_COLUMNS": ON_OR_OFF},
    ("blur/vignetting.cl",): {},
    ("sensor/sensor.cl",): {"FIXED_PATTERN": ON_OR_OFF},
    ("blur/convolve.cl",): {"WIDE_SUMS": ON_OR_OFF},
    ("inpainting/fse.cl",): {"CHANNELS": (1, 3)},
    ("inpainting/biharmonic.cl",): {"CHANNELS": (1, 3)},
    FORWARD: GEOMETRY
    | dict.fromkeys(("OWNED", "MAPPED", "FILL_AIT", "FILL_MEAN_MEDIAN", "FILL_FAR", "DOMAIN_SURFACE"), ON_OR_OFF),
}
PROGRAMS[HOLES] = {"CHANNELS": (1, 3), "CODES": ON_OR_OFF, "ALONE": ON_OR_OFF}
PROGRAMS[HOLES] |= {"FILL_MEAN_MEDIAN": (1,), "IMAGE": (1,)}
PROGRAMS[TILES] = PROGRAMS[SCATTER] | dict.fromkeys(("OCCLUDED", "CUT_CHORDS", "BORDERS"), (0,))
PROGRAMS[LAYERED] = {"CHANNELS": (1, 3), "ALPHA": ON_OR_OFF}
IN_DOUBLE = (TRACE_FILES, GATHER, SCATTER, TILES, FORWARD, LAYERED, ("inpainting/biharmonic.cl",))  # others: in floats
GIVEN_BY_THE_BUILD = {
    *("REAL_IS_DOUBLE", "HAS_INT64_ATOMICS", "HAS_FP64", "VECTOR_WIDTH", "defined"),
    *("CURVED_FIELD", "CURVED_SPHERE", "CURVED_IMAGE"),
    *("__FMA__", "__SSE4_1__", "__AVX__", "__AVX2__", "__AVX512F__", "__ATOMIC_RELAXED", "__SPIR__"),
}


def with_included(files: tuple[str, ...]) -> tuple[str, ...]:
    """Files with all that they include, whatever the features, in both forms."""
    found: dict[str, None] = {}
    waiting = [POCL_DECLARATIONS, BUILTINS, *files]
    while waiting:
        name = waiting.pop()
        path, _, last = name.rpartition("/")
        own = [f"{path}/cpu/{last}"] if (KERNELS / path / "cpu" / last).exists() else []
        for each in {name, *own} - found.keys():
            found[each] = None
            text = (KERNELS / each).read_text("utf-8")
            waiting += re.findall(r'^#include "(.*)"$', text, re.MULTILINE)
    return tuple(found)


def asked_for(files: tuple[str, ...]) -> set[str]:
    """Features by which the preprocessor chooses in files and those that they include, also by a name for several."""
    found: set[str] = set()
    joined: dict[str, str] = {}
    for name in with_included(files):
        text = (KERNELS / name).read_text("utf-8")
        joined |= dict(re.findall(r"^#define (\w+) (\(.*(?:&&|\|\|).*\))(?: *//.*)?$", text, re.MULTILINE))
        for condition in re.findall(r"^#\s*(?:el)?if\s+(.*)", text, re.MULTILINE):
            found |= set(re.findall(r"\b[A-Za-z_]\w*", condition.split("//")[0]))
    for name in found & joined.keys():
        found |= set(re.findall(r"\b[A-Za-z_]\w*", joined[name]))
    return found - joined.keys() - GIVEN_BY_THE_BUILD


def variants(features: dict[str, tuple[int, ...]]) -> list[dict[str, int]]:
    """None, all, and all but one; for features of several values each of them, with all others on."""
    off = {name: values[0] for name, values in features.items()}
    on = {name: values[min(1, len(values) - 1)] for name, values in features.items()}
    others = [on | {name: value} for name, values in features.items() for value in values if value != on[name]]
    alone = dict.fromkeys(("DISC", "SEPARABLE", "SAMPLED", "BY_COLUMNS"), 0)
    smooth = {**dict.fromkeys(("DISC", "SEPARABLE", "SAMPLED", "SPANS", "SHARED"), 0), "BY_COLUMNS": 1}
    others = [one | {k: v for k, v in smooth.items() if k in one} if one.get("WAVES") else one for one in others]
    others = [one | {"SPANS": 0} if one.get("SPANS") and not one["OCCLUDED"] else one for one in others]
    whole = {"CUT_CHORDS": 0}
    others = [one | whole if one.get("CUT_CHORDS") and not (one["OCCLUDED"] and one["RIMS"]) else one for one in others]
    others = [one | {"BORDERS": 0} if one.get("BORDERS") and not one["CUT_CHORDS"] else one for one in others]
    others = [one | {"GENERAL": 1} if one.get("EDGES") or one.get("FIELD") else one for one in others]
    others = [one | {"BY_COLUMNS": 1, "DISC": 0, "SEPARABLE": 0} if one.get("RING") else one for one in others]
    others = [one | dict.fromkeys(alone.keys() & one.keys(), 0) if one.get("GENERAL") else one for one in others]
    return [one | {"DISC": 0} if one.get("SEPARABLE") and one.get("BY_COLUMNS") else one for one in (off, on, *others)]


def test_every_file_is_built() -> None:
    built = {name for files in PROGRAMS for name in with_included(files)}
    assert built == {path.relative_to(KERNELS).as_posix() for path in KERNELS.rglob("*.cl*")}


@pytest.mark.parametrize("path", sorted(KERNELS.rglob("*.cl*")), ids=lambda path: path.name)
def test_contraction_ends_with_its_file(path: Path) -> None:
    """So that no bit depends on which files are built together, nor on their order."""
    text = path.read_text("utf-8")
    states = re.findall(r"^#pragma OPENCL FP_CONTRACT (ON|OFF)", text, re.MULTILINE)
    assert text.count("FP_CONTRACT") == len(states)
    assert not states or (states[0], states[-1]) == ("ON", "OFF")


def test_every_feature_is_known() -> None:
    """The preprocessor takes an unknown name for 0 without a word; and what nothing asks for is no feature."""
    plan = plan_of(Sphere())
    spreading = blur_features(spec_of(Psf(), 1.0), 1, True, "wide")
    asked = {name for features in PROGRAMS.values() for name in features}
    asked |= plan.features().keys() | spreading.keys() | forward_features(plan, owned=True).keys()
    assert asked <= FEATURES.keys()
    read = set().union(*(asked_for(files) for files in PROGRAMS))
    numbers = {"ALPHA", "LINEAR", "MOVED", "SAMPLED", "SCAN_COLUMNS", "OWNED", "MAPPED", "FILL_AIT", "FILL_FAR"}
    numbers |= {"DOMAIN_SURFACE"}
    assert FEATURES.keys() ^ read == numbers  # in the code


def built(session: Session, files: tuple[str, ...], features: dict[str, int], real: Real) -> Kernels:
    """The kernels of files."""
    return dict(ChainMap(*(build(session, file, features, structs(real), real) for file in files)))


# Of kernels that programs with all features lack, programs of cards have one, and those that scatter the other.
ELSEWHERE = {TILES: {"open_share"}}


def defined_in(files: tuple[str, ...]) -> set[str]:
    """Names of the kernels in some files."""
    text = "".join((KERNELS / file).read_text("utf-8") for file in files)
    return set(re.findall(r"__kernel void (\w+)\(", text))


@pytest.mark.parametrize("files", PROGRAMS, ids="+".join)
def test_with_all_features(session: Session, files: tuple[str, ...], capfd: pytest.CaptureFixture[str]) -> None:
    """Most of those that are off in one of these programs are so in many that other tests run."""
    real: Real = "double" if files in IN_DOUBLE else "float"
    program = built(session, files, variants(PROGRAMS[files])[1], real)
    assert program.keys() == defined_in(files) - ELSEWHERE.get(files, set())
    assert capfd.readouterr() == ("", "")  # of no warning that the compiler counts


@pytest.mark.slow
@pytest.mark.parametrize("files", PROGRAMS, ids="+".join)
def test_with_none_and_with_all_features_but_one(session: Session, files: tuple[str, ...]) -> None:
    """In double precision: `real` is a type, and what a feature compiles does not depend on it."""
    none, _, *others = variants(PROGRAMS[files])
    for features in (none, *others):
        built(session, files, features, "double")


def test_vectors_on_a_device_with_less(session: Session) -> None:
    """Files without vectors: test_plain_opencl.py."""
    lesser = replace(session.device, has_fp64=False, has_int64_atomics=False, correctly_rounded=False)
    with Session(lesser) as opened:
        built(opened, GATHER, variants(PROGRAMS[GATHER])[1] | {"SPANS": 0}, "float")
