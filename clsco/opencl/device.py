"""OpenCL devices: lists them, describes their properties, and chooses one, with the reason for the choice."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import pyopencl as cl

from clsco.errors import DeviceError
from clsco.opencl import pocl_cache as poclcache

cl._PYOPENCL_NO_CACHE = True  # the environment variable has no effect if the user imported pyopencl before clsco

NO_DEVICE = (
    "device: OpenCL needs a driver, and none with a device was found; "
    'install PoCL for the processor with `pip install "clsco[pocl]"`, or your GPU vendor\'s OpenCL driver'
)
_POCL = "Portable Computing Language"
_SHORT_OF_MEMORY = ("ALLOCATION_FAILURE", "OUT_OF_RESOURCES", "OUT_OF_HOST_MEMORY", "INVALID_BUFFER_SIZE")
_REASONS = (
    "the first GPU",
    "PoCL, as there is no GPU",
    "the first processor, as there is neither a GPU nor PoCL",
    "the first device, as there is neither a GPU nor a processor",
)


@dataclass(frozen=True)
class Device:
    """An OpenCL device and the properties that clsco uses; memory sizes and alignment are in bytes."""

    name: str
    platform: str
    platform_version: str
    driver: str
    kind: Literal["gpu", "cpu", "accelerator"]
    has_fp64: bool
    has_int64_atomics: bool
    correctly_rounded: bool  # an option of the compiler rounds float32 division and square root as NumPy does
    unified_memory: bool  # the device uses the host's memory, so that an aligned array needs no copy
    alignment: int
    max_alloc: int
    global_mem: int
    compute_units: int
    vector_width: int  # number of floats with which the device computes at once
    max_work_group: int
    handle: cl.Device = field(repr=False)

    @property
    def is_pocl(self) -> bool:
        return self.platform == _POCL

    def __str__(self) -> str:
        return f"{self.name} ({self.platform})"


@dataclass(frozen=True)
class Choice:
    """The device to use, or None if none is usable, and the reason in words."""

    device: Device | None
    reason: str


def list_devices(name: str | None = None, source: str = "device") -> tuple[tuple[Device, ...], Choice]:
    """List the OpenCL devices, and choose the one that clsco would use.

    Parameters
    ----------
    name : str, optional
        As `device` of `clsco.render`: a part of a name, "cpu" or "gpu".
    source : str
        Source of `name`, for the reason.

    Returns
    -------
    devices : tuple of Device
        All devices, in the order of their platforms.
    choice : Choice
        The device to use, and the reason in words.

    Notes
    -----
    If no device can be chosen, the device of `choice` is None, and the reason says why; no error is raised.

    Examples
    --------
    >>> import clsco
    >>> devices, choice = clsco.list_devices()
    >>> choice.device in devices
    True
    """
    devices = _devices()
    try:
        return devices, pick(devices, name, os.environ, _by_pyopencl, source)
    except DeviceError as error:
        return devices, Choice(None, str(error))


def choose(name: str | None = None, source: str = "device") -> Device:
    """Choose a device by `name`, else by CLSCO_DEVICE or PYOPENCL_CTX, else a GPU, PoCL, another processor, or any
    device.

    Never prompts. Case does not matter in `name`. It is first compared with the kind of devices ("gpu" or "cpu") and
    with their whole names, then with parts of the name and version of their platforms, then with parts of their names.
    source: source of `name`, for messages. Raises DeviceError if there is no device, or none matches.
    """
    chosen = pick(_devices(), name, os.environ, _by_pyopencl, source).device
    if chosen is None:
        why = poclcache.shortage()  # a limit that hides drivers from their loader
        raise DeviceError(f"{NO_DEVICE}; got {why}" if why else NO_DEVICE)
    return chosen


def pick(
    devices: Sequence[Device], name: str | None, environ: Mapping[str, str], by_pyopencl: Callable[[str], cl.Device],
    origin: str = "device",
) -> Choice:  # fmt: skip
    """Choose by the rule of `choose`; by_pyopencl: returns the device for a PYOPENCL_CTX; origin: source of `name`."""
    if not devices:
        return Choice(None, NO_DEVICE)
    for source, text in ((origin, name), ("CLSCO_DEVICE", environ.get("CLSCO_DEVICE"))):
        if text:
            return Choice(_match_device(devices, source, text), f'{source} is "{text}"')
    if specification := environ.get("PYOPENCL_CTX"):
        handle = by_pyopencl(specification)
        return Choice(describe_device(handle), f'PYOPENCL_CTX is "{specification}"')
    best = min(devices, key=_rank)  # the first of equal rank, so that the order of the platforms decides
    return Choice(best, _REASONS[_rank(best)])


def failure(device: Device, task: str, error: cl.Error | OSError) -> DeviceError:
    """The error to raise if a device fails; task: what the device must do, for the message; error: the cause."""
    short = isinstance(error, cl.MemoryError | OSError) or any(word in str(error) for word in _SHORT_OF_MEMORY)
    return DeviceError(f"device {device}: must {task}; got {error}", short_of_memory=short)


_process: int | None = None  # id of the process that used OpenCL first


def check_not_forked() -> None:
    """Raise DeviceError in a fork of a process that has used OpenCL, because PoCL would hang there."""
    global _process
    _process = _process or os.getpid()
    if _process != os.getpid():
        rule = "OpenCL must be used in the process that began to, or in others that are started by spawning"
        raise DeviceError(f"device: {rule}; got a fork of process {_process}")


def _rank(device: Device) -> int:
    if device.kind == "gpu":
        return 0
    if device.is_pocl:
        return 1
    return 2 if device.kind == "cpu" else 3


def _match_device(devices: Sequence[Device], source: str, text: str) -> Device:
    part = text.lower()

    def likeness(device: Device) -> int:
        """0 for the kind or whole name, 1 for a part of the platform's name or version, 2 for a part of the device's
        name, which drivers of other vendors may share, 3 for no match.
        """
        name, platform = device.name.lower(), (device.platform.lower(), device.platform_version.lower())
        if part in (device.kind, name):
            return 0
        return 1 if any(part in text for text in platform) else 2 if part in name else 3

    matches = [device for device in devices if likeness(device) < 3]
    if not matches:
        names = ", ".join(map(str, devices))
        raise DeviceError(f'{source}: must be a part of the name of one of {names}; got "{text}"')
    return min(matches, key=lambda device: (likeness(device), _rank(device)))


def _by_pyopencl(specification: str) -> cl.Device:
    try:
        return cl.choose_devices(interactive=False, answers=specification.split(":"))[0]
    except (RuntimeError, cl.Error) as error:
        raise DeviceError(f'PYOPENCL_CTX: must name a platform and device; got "{specification}": {error}') from error


@poclcache.held_signals()
def _devices() -> tuple[Device, ...]:
    check_not_forked()
    try:
        poclcache.prepare()  # PoCL reads the variable at the first query of its platform
    except OSError as error:
        raise DeviceError(f"device: PoCL must have a folder for compiled kernels; got {error}") from error
    try:
        platforms = cl.get_platforms()
    except cl.LogicError:  # raised by the loader if no driver is installed
        return ()
    handles = []
    for platform in platforms:
        try:
            handles.extend(platform.get_devices())
        except cl.Error:  # a driver is installed, but its hardware is missing
            continue
    return tuple(describe_device(handle) for handle in handles)


def describe_device(handle: cl.Device) -> Device:
    extensions = handle.extensions.split()
    kinds = cl.device_type
    return Device(
        name=handle.name.strip(),
        platform=handle.platform.name.strip(),
        platform_version=handle.platform.version.strip(),
        driver=handle.driver_version.strip(),
        # A simulator claims to be of all kinds at once, and must not be mistaken for a GPU.
        kind="cpu" if handle.type & kinds.CPU else "gpu" if handle.type & kinds.GPU else "accelerator",
        has_fp64="cl_khr_fp64" in extensions,
        has_int64_atomics={"cl_khr_int64_base_atomics", "cl_khr_int64_extended_atomics"} <= set(extensions),
        correctly_rounded=bool(handle.single_fp_config & cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT),
        unified_memory=bool(handle.type & kinds.CPU),
        alignment=handle.mem_base_addr_align // 8,
        max_alloc=handle.max_mem_alloc_size,
        global_mem=handle.global_mem_size,
        compute_units=handle.max_compute_units,
        vector_width=handle.native_vector_width_float,
        max_work_group=handle.max_work_group_size,
        handle=handle,
    )
