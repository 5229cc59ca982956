"""The command `clsco devices`."""

from __future__ import annotations

import click

from clsco.cli.options import device_option, flag, require_opencl
from clsco.cli.output import echo
from clsco.errors import ClscoError, DeviceError


@click.command()
@device_option
@flag("--self-test tested", "Run small kernels on each device.")
def devices(device: str | None, tested: bool) -> None:
    """List OpenCL devices, what each can do, and which one is used and why."""
    require_opencl()
    from clsco.cli.tables import device_tables, print_tables
    from clsco.opencl.device import list_devices
    from clsco.opencl.self_test import self_test

    all_devices, choice = list_devices(device, "--device")
    checks = {item: self_test(item) for item in all_devices} if tested else {}
    if all_devices:
        print_tables(*device_tables(all_devices, choice.device, checks))
    if choice.device is None:
        raise DeviceError(choice.reason)
    echo(f"used: {choice.device} ({choice.reason})")
    failed = [f"{item}: {check.name}" for item, results in checks.items() for check in results if not check.passed]
    if failed:
        raise ClscoError(f"self-test: every check must pass; got failures in {', '.join(failed)}")
