"""The order in which a device is chosen, on made-up lists, and the facts and the self-test on PoCL."""

from __future__ import annotations

import resource
import warnings
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pyopencl as cl
import pytest

import clsco
from clsco.errors import DeviceError
from clsco.frame.frame import Frame
from clsco.opencl import self_test as self_test_module
from clsco.opencl import source_text
from clsco.opencl.device import NO_DEVICE, Choice, Device, choose, list_devices, pick
from clsco.opencl.self_test import self_test
from clsco.opencl.session import Session, session_on


def fake(name: str, platform: str, kind: str, version: str = "OpenCL 3.0") -> Device:
    return Device(
        name=name, platform=platform, platform_version=version, driver="1", kind=cast(Any, kind), has_fp64=True,
        has_int64_atomics=True, correctly_rounded=True, unified_memory=kind == "cpu", alignment=128, max_alloc=2**30,
        global_mem=2**32, compute_units=2, vector_width=8, max_work_group=1024, handle=cast(cl.Device, None),
    )  # fmt: skip


SIMULATOR = fake("Oclgrind Simulator", "Oclgrind", "cpu")
POCL = fake("pthread-Some CPU", "Portable Computing Language", "cpu", "OpenCL 3.0 PoCL 3.0")
VENDOR_CPU = fake("Some CPU", "Vendor CPU Runtime", "cpu")
GPU = fake("GeForce 1", "NVIDIA CUDA", "gpu")
SECOND_GPU = fake("GeForce 2", "NVIDIA CUDA", "gpu")
FPGA = fake("Board", "FPGA SDK", "accelerator")
XEON, POCL_ON_XEON = replace(VENDOR_CPU, name="Xeon", platform="Xeon SDK"), replace(POCL, name="pthread-Xeon E5")


def never(specification: str) -> cl.Device:
    raise AssertionError(f"pyopencl must not be asked; got {specification}")


@pytest.mark.parametrize(
    ("devices", "name", "environ", "expected"),
    [
        ([SIMULATOR, POCL, GPU, SECOND_GPU], None, {}, GPU),
        ([FPGA, SIMULATOR, VENDOR_CPU, POCL], None, {}, POCL),
        ([FPGA, VENDOR_CPU, SIMULATOR], None, {}, VENDOR_CPU),
        ([FPGA], None, {}, FPGA),
        ([POCL, GPU], "pocl", {}, POCL),
        ([POCL, GPU], "PORTABLE", {}, POCL),
        ([POCL, GPU], "cpu", {}, POCL),
        ([SIMULATOR, POCL], "oclgrind", {}, SIMULATOR),
        ([POCL, GPU, SECOND_GPU], "geforce", {}, GPU),
        ([POCL, GPU, SECOND_GPU], "geforce 2", {}, SECOND_GPU),
        ([VENDOR_CPU, POCL], "some cpu", {}, VENDOR_CPU),
        ([POCL_ON_XEON, XEON], "xeon", {}, XEON),
        ([POCL_ON_XEON, XEON], "xeon e5", {}, POCL_ON_XEON),
        ([POCL_ON_XEON, XEON], "cpu", {}, POCL_ON_XEON),
        ([POCL, GPU], None, {"CLSCO_DEVICE": "pthread"}, POCL),
        ([POCL, GPU], "nvidia", {"CLSCO_DEVICE": "pthread", "PYOPENCL_CTX": "0"}, GPU),
        ([POCL, GPU], None, {"CLSCO_DEVICE": "pthread", "PYOPENCL_CTX": "1"}, POCL),
        ([POCL, GPU], None, {"CLSCO_DEVICE": "", "PYOPENCL_CTX": ""}, GPU),
        ([POCL, GPU], "", {}, GPU),
    ],
)
def test_order(devices: list[Device], name: str | None, environ: Mapping[str, str], expected: Device) -> None:
    assert pick(devices, name, environ, never).device is expected


def test_reason_names_what_decided() -> None:
    assert pick([POCL, GPU], None, {}, never).reason == "the first GPU"
    assert pick([POCL], "pocl", {}, never).reason == 'device is "pocl"'
    assert pick([POCL], "pocl", {}, never, "--device").reason == '--device is "pocl"'
    assert pick([POCL], None, {"CLSCO_DEVICE": "pocl"}, never).reason == 'CLSCO_DEVICE is "pocl"'


@pytest.mark.parametrize(("name", "environ"), [("amd", {}), (None, {"CLSCO_DEVICE": "amd"})])
def test_a_name_that_matches_nothing(name: str | None, environ: Mapping[str, str]) -> None:
    source = "device" if name else "CLSCO_DEVICE"
    with pytest.raises(DeviceError, match=rf'^{source}: .*GeForce 1 \(NVIDIA CUDA\); got "amd"$'):
        pick([POCL, GPU], name, environ, never)


def test_nothing_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_platforms() -> list[cl.Platform]:
        raise cl.LogicError("clGetPlatformIDs failed: PLATFORM_NOT_FOUND_KHR")

    monkeypatch.setattr(cl, "get_platforms", no_platforms)
    assert list_devices() == ((), Choice(None, NO_DEVICE))
    with pytest.raises(DeviceError, match=r'pip install "clsco\[pocl\]"'):
        choose()
    monkeypatch.setattr("resource.getrlimit", lambda kind: (5, 5) if kind == resource.RLIMIT_NOFILE else (-1, -1))
    with pytest.raises(DeviceError, match=r"got a limit of 5 open files \(ulimit -n\)$"):
        choose()


def test_pyopencl_ctx_means_what_it_means_to_pyopencl(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CLSCO_DEVICE", raising=False)
    monkeypatch.setenv("PYOPENCL_CTX", "portable")
    devices, choice = list_devices()
    assert choice.device in devices
    assert choice.reason == 'PYOPENCL_CTX is "portable"'
    monkeypatch.setenv("PYOPENCL_CTX", "no such platform")
    with pytest.raises(DeviceError, match=r'^PYOPENCL_CTX: .*got "no such platform"'):
        choose()
    _, choice = list_devices()
    assert choice.device is None
    assert choice.reason.startswith("PYOPENCL_CTX: ")


@pytest.mark.processor
def test_facts_of_pocl(session: Session) -> None:
    device = session.device
    assert device.is_pocl
    assert device.kind == "cpu"
    assert device.unified_memory
    assert device.compute_units >= 1
    assert 0 < device.max_alloc <= device.global_mem
    assert str(device) == f"{device.name} (Portable Computing Language)"


def test_self_test_passes_on_pocl(session: Session) -> None:
    checks = self_test(session.device)
    assert [check for check in checks if not check.passed] == []
    names = {check.name for check in checks}
    assert {"float32 addition", "int32 atomics", "exact fma", "no contraction"} <= names
    assert ("fp64" in names) == session.device.has_fp64
    assert ("int64 atomics" in names) == session.device.has_int64_atomics


def test_what_a_compiler_says_is_no_warning_of_the_self_test(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """NVIDIA's has something to say of any program; warnings are errors here."""
    build = cl.Program.build

    def talkative(*given: Any) -> cl.Program:
        warnings.warn("Non-empty compiler output encountered.", cl.CompilerWarning, stacklevel=2)
        return build(*given)

    monkeypatch.setattr(cl.Program, "build", talkative)
    assert all(check.passed for check in self_test(session.device))


def test_self_test_reports_a_wrong_answer_and_a_failing_compiler(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = self_test_module._PROBES[0]
    wrong = replace(good, body="out[i] = i == 3 ? -5 : i + 1;")
    broken = replace(good, body="this is no C;")
    monkeypatch.setattr(self_test_module, "_PROBES", (good, wrong, broken))
    checks = self_test(session.device)
    assert [check.passed for check in checks] == [True, False, False]
    assert checks[1].detail == "work-item 3: must be 4; got -5"
    assert "BUILD_PROGRAM_FAILURE" in checks[2].detail


def intel() -> Device:
    for device in list_devices()[0]:
        if device.kind == "cpu" and device.platform == "Intel(R) OpenCL":
            return device
    pytest.skip("Intel's runtime for processors is not installed")


def test_the_self_test_finds_what_intels_compiler_does_to_vectors_of_3(monkeypatch: pytest.MonkeyPatch) -> None:
    device, begin = intel(), source_text.program_text
    assert [check for check in self_test(device) if not check.passed] == []

    def without_hint(*arguments: Any) -> str:
        return begin(*arguments).replace("#ifdef cl_intel_vec_len_hint", "#if 0")

    monkeypatch.setattr(source_text, "program_text", without_hint)
    assert [check.name for check in self_test(device) if not check.passed] == ["vectors of 3 as arguments"]


def test_occluders_on_intels_runtime_are_those_on_pocl() -> None:
    camera = {"resolution": [48, 36], "pixel_pitch": 0.1}
    ball = {"shape": "sphere", "center": [-6.0, 3.0, 190.0], "radius": 9.0}
    scene = clsco.parse_scene({"camera": camera, "object": [ball, {"shape": "plane", "distance": 380.0}]})
    one, other = (clsco.render_frame(scene, device=device).color for device in ("pocl", intel().handle))
    np.testing.assert_allclose(other, one, rtol=0, atol=2e-6)


def frames(side: int) -> list[Frame]:
    camera = {"resolution": [side, side], "f_number": 4}
    scene = {"camera": camera, "sequence": {"frames": 3}, "object": [{"shape": "sphere", "radius": 30.0}]}
    return list(clsco.render(clsco.parse_scene(scene)))


def test_renders_share_a_session_and_its_programs() -> None:
    frames(16)
    session = session_on(choose())
    programs = dict(session.programs)
    assert programs
    frames(20)
    assert session_on(choose()) is session
    assert session.programs == programs  # PoCL would keep the memory of each one that is built anew


@pytest.mark.parametrize(("error", "kept"), [("OUT_OF_RESOURCES", True), ("DEVICE_NOT_AVAILABLE", False)])
def test_a_session_whose_device_fails_is_not_used_again(error: str, kept: bool) -> None:
    session = session_on(choose())
    with pytest.raises(DeviceError, match=error), session.reporting():
        raise cl.RuntimeError(f"clFinish failed: {error}")
    assert (session_on(choose()) is session) == kept


def test_threads_render_side_by_side() -> None:
    sides = [24, 40, 33, 24, 40, 33]
    alone = [frames(side) for side in sides]
    with ThreadPoolExecutor(len(sides)) as pool:
        together = list(pool.map(frames, sides))
    for one, other in zip(alone, together, strict=True):
        for frame, again in zip(one, other, strict=True):
            np.testing.assert_array_equal(frame.color, again.color)
            np.testing.assert_array_equal(frame.depth, again.depth)


def test_a_closed_session_can_be_followed_by_another(session: Session) -> None:
    for _ in range(3):
        with Session(session.device) as opened:
            assert opened.context.devices == [session.device.handle]
        assert opened.programs == {}
