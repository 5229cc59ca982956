"""Building, launching and moving arrays, with small kernels of the tests' own."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pyopencl as cl
import pytest

from clsco import resources
from clsco.errors import DeviceError, KernelError
from clsco.opencl import program as program_module
from clsco.opencl import self_test, source_text
from clsco.opencl.buffers import download, empty, upload
from clsco.opencl.device import Device
from clsco.opencl.program import WITHOUT_HEADER, Target, build, launch
from clsco.opencl.session import Session
from clsco.opencl.source_text import program_text, struct_text

POSE = np.dtype([("angle", "f8"), ("axis", "f4", (3,)), ("id", "i4")], align=True)
SCENE = np.dtype([("count", "i2"), ("pose", POSE, (2,)), ("turn", "f4", (2, 3)), ("last", "u8")], align=True)
STRUCTS = {"Pose": POSE, "Scene": SCENE}

HEADER = """\
static inline real twice(real x)
{
    return 2 * x;
}
"""
WORK = """\
__kernel void count(int n, __global int *out)
{
    int i = get_global_id(0);
    if (i >= n) return;
    out[i] += (int)twice(i) + EXTRA;
}

__kernel void fields(Scene scene, __global double *out)
{
    if (get_global_id(0) > 0) return;
    out[0] = scene.count;
    out[1] = scene.pose[1].angle;
    out[2] = scene.pose[1].axis[2];
    out[3] = scene.pose[1].id;
    out[4] = scene.turn[1][2];
    out[5] = scene.last;
}

__kernel void arithmetic(int n, __global const float *x, __global float *out)
{
    int i = get_global_id(0);
    if (i >= n) return;
    out[4 * i] = x[i] * x[i] - x[n - 1 - i];
    out[4 * i + 1] = x[i] / (x[n - 1 - i] + 1);
    out[4 * i + 2] = sqrt(x[i]);
    out[4 * i + 3] = x[i] + 0.1f * x[n - 1 - i];
}

__kernel void real_size(__global int *out)
{
    if (get_global_id(0) > 0) return;
    out[0] = sizeof(real);
    out[1] = sizeof(real16);
    out[2] = REAL_IS_DOUBLE;
    out[3] = HAS_FP64;
    out[4] = HAS_INT64_ATOMICS;
    out[5] = sizeof(1.5 * (real)1);
}
"""


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "common/cpu").mkdir(parents=True)
    declared = resources.folder("kernels") / "common/cpu/pocl.clh"
    (tmp_path / "common/cpu/pocl.clh").write_text(declared.read_text("utf-8"))
    (tmp_path / program_module.BUILTINS).write_text("")
    (tmp_path / "header.clh").write_text(HEADER)
    (tmp_path / "work.cl").write_text('#include "header.clh"\n' + WORK)
    monkeypatch.setattr(program_module, "folder", lambda name: tmp_path)
    monkeypatch.setattr(source_text, "folder", lambda name: tmp_path)
    return tmp_path


def built(session: Session, extra: int = 0, real: Any = "double") -> dict[str, cl.Kernel]:
    return build(session, "work.cl", {"EXTRA": extra}, STRUCTS, real)


@pytest.mark.usefixtures("kernels")
def test_launch_covers_every_item_once_and_none_beyond(session: Session) -> None:
    for count in (1, 63, 64, 65, 1000):
        buffer = empty(session, 4 * 1024)
        cl.enqueue_fill_buffer(session.queue, buffer, np.array(-7, np.int32), 0, 4 * 1024)
        launch(session, built(session, 5)["count"], (count,), (64,), np.int32(count), buffer)
        got = download(session, buffer, (1024,), np.int32)
        expected = np.where(np.arange(1024) < count, 2 * np.arange(1024) + 5 - 7, -7)
        np.testing.assert_array_equal(got, expected)


@pytest.mark.usefixtures("kernels")
def test_the_same_request_gives_the_same_program_and_another_feature_another(session: Session) -> None:
    assert built(session, 1) is built(session, 1)
    assert built(session, 1) is not built(session, 2)
    assert built(session, 1) is not built(session, 1, "float")
    with Session(session.device) as other:
        assert built(other, 1) is not built(session, 1)


OTHER = """\
__kernel void count(int n, __global int *out)
{
    int i = get_global_id(0);
    if (i < n) out[i] = (int)rotate((uint)i, 4u) + EXTRA;
}
"""


def test_a_kernel_may_call_what_is_not_declared(
    session: Session, kernels: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PoCL's header is left out where all functions of a program are declared, and only there."""
    options, compiled = list[list[str]](), program_module._compile

    def noted(*given: Any) -> Any:
        options.append(given[-1])
        return compiled(*given)

    monkeypatch.setattr(program_module, "_compile", noted)
    left_out = session.device.is_pocl and session.device.kind == "cpu"
    built(session, 21)
    assert [WITHOUT_HEADER in one for one in options] == [left_out]
    (kernels / "work.cl").write_text(OTHER)
    buffer = empty(session, 4 * 64)
    launch(session, built(session, 22)["count"], (64,), (64,), np.int32(64), buffer)
    np.testing.assert_array_equal(download(session, buffer, (64,), np.int32), 16 * np.arange(64) + 22)
    assert [WITHOUT_HEADER in one for one in options[1:]] == ([True, False] if left_out else [False])


@pytest.mark.usefixtures("kernels")
def test_structs_arrive_field_by_field(session: Session) -> None:
    scene = np.zeros((), SCENE)
    scene["count"], scene["last"] = 3, 2**40
    scene["pose"]["angle"][1], scene["pose"]["axis"][1, 2], scene["pose"]["id"][1] = 0.1, 0.5, -4
    scene["turn"][1, 2] = 0.25
    buffer = empty(session, 6 * 8)
    launch(session, built(session)["fields"], (1,), (1,), scene[()], buffer)
    np.testing.assert_array_equal(download(session, buffer, (6,), np.float64), [3, 0.1, 0.5, -4, 0.25, 2**40])


@pytest.mark.usefixtures("kernels")
def test_float32_arithmetic_has_the_bits_of_numpy(session: Session) -> None:
    # No tolerance: +, -, x, / and sqrt are correctly rounded on both sides and never contracted.
    x = np.random.default_rng(1).random(4096, np.float32)
    assert np.unique(x).size > 4000
    y = x[::-1]
    expected = np.stack([x * x - y, x / (y + np.float32(1)), np.sqrt(x), x + np.float32(0.1) * y], axis=1)
    buffer = empty(session, expected.nbytes)
    launch(session, built(session)["arithmetic"], (x.size,), (64,), np.int32(x.size), upload(session, x), buffer)
    got = download(session, buffer, expected.shape, np.float32)
    np.testing.assert_array_equal(got.view(np.uint32), expected.view(np.uint32))


@pytest.mark.usefixtures("kernels")
@pytest.mark.parametrize(("real", "size"), [("double", 8), ("float", 4)])
def test_real(session: Session, real: str, size: int) -> None:
    buffer = empty(session, 6 * 4)
    launch(session, built(session, real=real)["real_size"], (1,), (1,), buffer)
    device = session.device
    expected = [size, 16 * size, size == 8, device.has_fp64, device.has_int64_atomics, size]
    np.testing.assert_array_equal(download(session, buffer, (6,), np.int32), expected)


@pytest.mark.processor
def test_a_build_error_names_file_and_line(
    session: Session, kernels: Path, caplog: pytest.LogCaptureFixture
) -> None:  # fmt: skip
    (kernels / "work.cl").write_text(
        WORK.replace("out[2] = sqrt", "out[2] = sqroot").replace("scene.last", "scene.lost")
    )
    caplog.set_level("INFO")
    with pytest.raises(KernelError, match=r"^work\.cl: must build on ") as caught:
        built(session)
    line, message = 1 + WORK[: WORK.index("scene.last")].count("\n"), str(caught.value)
    assert f"work.cl:{line}:" in message
    assert "-DVECTOR_WIDTH=" not in message
    assert "-DVECTOR_WIDTH=" in caplog.text


@pytest.mark.processor
def test_a_header_error_names_the_header(session: Session, kernels: Path) -> None:
    (kernels / "header.clh").write_text(HEADER.replace("2 * x;", "2 * y;"))
    with pytest.raises(KernelError, match=r"header\.clh:3:"):
        built(session)


def test_compiler_warnings_stay_out_of_the_way_unless_asked_for(
    session: Session, kernels: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A fresh name, since PoCL only gives a warning when it really compiles.
    name = f"odd_{kernels.name.replace('-', '_')}"
    (kernels / "work.cl").write_text(f'#include "header.clh"\n#warning {name}\n{WORK}')
    monkeypatch.delenv("PYOPENCL_COMPILER_OUTPUT", raising=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        built(session)
    (kernels / "work.cl").write_text(f'#include "header.clh"\n#warning {name} again\n{WORK}')
    monkeypatch.setenv("PYOPENCL_COMPILER_OUTPUT", "1")
    with pytest.warns(cl.CompilerWarning, match=name):
        built(session, 1)


CONDITIONS = """\
#include "header.clh"
#if ON && !OFF  // decided
a
#if defined(__AVX__)
b
#elif ON == 1
c
#endif
#elif ON
d
#else
e
#include "missing.clh"
#endif
#define BOTH (ON && OFF)
#if BOTH
f
#elif UNKNOWN
g
#else
h
#endif
#include "header.clh"
i
"""


def test_what_features_leave_out_does_not_reach_the_compiler(kernels: Path) -> None:
    (kernels / "header.clh").write_text("of all\n")
    (kernels / "cpu").mkdir()
    (kernels / "work.cl").write_text(CONDITIONS)

    def lines(on_cpu: bool) -> list[str]:
        text = program_text(["work.cl"], {}, "float", False, False, {"ON": 1, "OFF": 0}, on_cpu)
        return [line for line in text.split('#line 1 "work.cl"\n')[1].split("\n") if line]

    left = ["#if defined(__AVX__)", "b", "#elif ON == 1", "c", "#endif", "#define BOTH (ON && OFF)"]
    rest = ["#if UNKNOWN", "g", "#else", "h", "#endif", '#line 24 "work.cl"', "i"]
    assert lines(False) == ['#line 1 "header.clh"', "of all", '#line 2 "work.cl"', "a", *left, *rest]
    (kernels / "cpu/header.clh").write_text("of processors\n")
    assert lines(True) == ['#line 1 "cpu/header.clh"', "of processors", '#line 2 "work.cl"', "a", *left, *rest]


def test_a_file_is_built_when_one_of_its_kernels_is_used(session: Session, kernels: Path) -> None:
    (kernels / "plain.cl").write_text("__kernel void plain(int n) {}\n")
    (kernels / "broken.cl").write_text("__kernel void broken(int n) { this is no C }\n")
    target = Target(session, ["plain.cl", "broken.cl"], {}, "float")
    assert target["plain"] is target["plain"]
    with pytest.raises(KernelError, match=r"^broken\.cl: must build on "):
        target["broken"]
    with pytest.raises(KernelError, match=r"^kernel: must be one of broken, plain; got missing$"):
        target["missing"]
    with pytest.raises(KernelError, match=r"got no missing\.cl$"):
        build(session, "missing.cl", {}, {}, "double")


@pytest.mark.usefixtures("kernels")
def test_double_on_a_device_without_it(session: Session) -> None:
    with Session(replace(session.device, has_fp64=False)) as lesser:
        with pytest.raises(DeviceError, match=r"^precision: .*fp64"):
            built(lesser)
        assert "cl_khr_fp64" not in program_text(["work.cl"], {}, "float", False, False)


@pytest.mark.parametrize(
    ("dtype", "message"),
    [
        (np.dtype([("a", "f8"), ("b", "i4")]), "align=True"),
        (np.dtype("f8"), "align=True"),
        (np.dtype([("a", "f2")], align=True), "got a: float16"),
        (np.dtype([("a", POSE)], align=True), "got a: "),
    ],
)
def test_structs_that_cannot_be_given(dtype: np.dtype[Any], message: str) -> None:
    with pytest.raises(KernelError, match=message):
        struct_text("S", dtype, {})


def test_a_struct_whose_layout_is_not_the_compilers_does_not_build(session: Session, kernels: Path) -> None:
    tail = np.dtype({"names": ["a", "b"], "formats": ["f8", "i4"], "offsets": [0, 8], "itemsize": 24}, align=True)
    (kernels / "work.cl").write_text("__kernel void none(void) {}\n")
    with pytest.raises(KernelError, match="Tail_has_the_size_of_its_dtype"):
        build(session, "work.cl", {}, {"Tail": tail}, "double")


def aligned(values: np.ndarray[Any, Any], offset: int, alignment: int) -> np.ndarray[Any, Any]:
    """A copy whose first byte lies `offset` bytes after a multiple of `alignment`."""
    memory = np.empty(values.nbytes + 2 * alignment, np.uint8)
    start = -memory.ctypes.data % alignment + offset
    copy: np.ndarray[Any, Any] = np.ndarray(values.shape, values.dtype, memory, start)
    copy[...] = values
    return copy


def test_arrays_go_and_come_back(session: Session) -> None:
    values = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
    alignment = session.device.alignment
    for given in (
        values,
        aligned(values, 0, alignment),
        aligned(values, 4, alignment),
        values[:, ::-1, ::2],
        values[:0],
    ):
        got = download(session, upload(session, given), given.shape, given.dtype)
        np.testing.assert_array_equal(got, given)
        assert got.flags.owndata
        assert got.flags.writeable


@pytest.mark.processor
def test_an_aligned_array_is_used_in_place_and_kept_alive(session: Session) -> None:
    values = np.arange(1000, dtype=np.float32)
    given = aligned(values, 0, session.device.alignment)
    buffer = upload(session, given)
    given[7] = -1  # what the caller must not do shows that nothing was copied
    del given
    expected = np.where(values == 7, -1, values)
    np.testing.assert_array_equal(download(session, buffer, values.shape, values.dtype), expected)
    other = aligned(values, 4, session.device.alignment)
    buffer = upload(session, other)
    other[7] = -1
    np.testing.assert_array_equal(download(session, buffer, values.shape, values.dtype), values)


def test_a_buffer_that_is_too_large(session: Session) -> None:
    size = session.device.max_alloc + 1
    with pytest.raises(DeviceError, match=rf"at most {session.device.max_alloc} bytes; got {size}$"):
        empty(session, size)


def test_a_kept_program_that_pocl_cannot_read_is_built_anew(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """PoCL 3.0 gives a program without kernels then, and says nothing."""
    builds: list[list[str]] = []

    class Unreadable(cl.Program):
        def build(self, *options: Any, **given: Any) -> cl.Program:
            builds.append(*options)
            return super().build(*options, **given)

        def all_kernels(self) -> Any:
            return super().all_kernels() if len(builds) > 1 else []

    monkeypatch.setattr(cl, "Program", Unreadable)
    found = program_module._compile(session, "one.cl", "kernel void one(global int* a) { a[0] = 1; }", [])
    assert list(found) == ["one"]
    assert builds[0] == []
    assert builds[1][-1].startswith("-DBUILT_ANEW=")


def test_the_hint_for_intels_compiler_stands_before_all_kernels() -> None:
    text = program_text(["common/cpu/builtins.clh", "blur/blur.cl"], {}, "float", True, True)
    hint = "#ifdef cl_intel_vec_len_hint\n#define __kernel __attribute__((intel_vec_len_hint(1))) __kernel\n#endif\n"
    assert text.count(hint) == 1
    assert "__kernel" not in text.partition(hint)[0]


@pytest.mark.processor
def test_another_driver_than_pocl_is_used_once_it_passes_arguments_rightly(
    session: Session, monkeypatch: pytest.MonkeyPatch, kernels: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(kernels))
    run, probe = Mock(wraps=self_test._run_probe), self_test._ARGUMENTS
    monkeypatch.setattr(self_test, "_run_probe", run)
    wrong = replace(probe, body="out[i] = i == 3 ? -5 : 7 * i + 10;")
    other = replace(session.device, platform="Another", driver="1.5")

    def first_program(device: Device) -> None:
        with Session(device) as opened:
            built(opened)

    monkeypatch.setattr(self_test, "_ARGUMENTS", wrong)
    first_program(session.device)
    assert run.call_count == 0  # PoCL
    said = r"^device .* \(Another\): driver 1\.5 must pass .* as arguments, work-item 3: must be 31; got -5$"
    for _ in range(2):  # what fails is not kept
        with pytest.raises(DeviceError, match=said):
            first_program(other)
    monkeypatch.setattr(self_test, "_ARGUMENTS", replace(wrong, body="this is no C;"))
    with pytest.raises(DeviceError, match="BUILD_PROGRAM_FAILURE"):
        first_program(other)
    monkeypatch.setattr(self_test, "_ARGUMENTS", probe)
    for device in (other, other, replace(other, driver="1.6")):
        first_program(device)
    assert run.call_count == 5  # the second driver of the same number is known
