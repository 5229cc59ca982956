"""The command `clsco studio`."""

from __future__ import annotations

import ipaddress
from pathlib import Path

import click

from clsco.cli.options import PATH, device_option, flag, option, require_device
from clsco.cli.output import echo
from clsco.errors import MissingDependencyError, SceneError


@click.command()
@click.argument("scene", type=PATH, required=False)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port to listen at; 0 (default): any free one.")
@click.option(
    "--host", default="", help="Address to listen at. Default: of this machine alone, another for each start."
)
@flag("--allow-network", "Let --host be an address that other machines reach.")
@option("--root", "DIR", "Folder with all files to read and write. Default: SCENE's.", PATH)
@device_option
@flag("--no-browser", "Only print the address.")
def studio(
    scene: Path | None, port: int, host: str, allow_network: bool, root: Path | None, device: str | None,
    no_browser: bool,
) -> None:  # fmt: skip
    """Edit a scene in the browser while it is rendered.

    Only this machine can reach the studio, unless you give --host and --allow-network, and only with the printed
    address, which contains a secret token.
    """
    try:
        is_loopback = host in ("", "localhost") or ipaddress.ip_address(host).is_loopback
    except ValueError:
        raise click.UsageError(f"--host: must be an address; got {host}") from None
    if not is_loopback and not allow_network:
        raise click.UsageError(f"--host: needs --allow-network, as other machines reach it; got {host}")
    root = root or (scene.parent if scene is not None else Path.cwd())
    if not root.is_dir():
        raise SceneError(f"--root: must be a folder; got {root}")
    try:
        from clsco.studio.page import draw
        from clsco.studio.server import Studio, serve
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            f"studio: needs {error.name}: pip install 'clsco[studio]'; got no such module"
        ) from None
    require_device(device)
    opened = Studio(root, scene, device)
    opened.new_session()  # raises for a scene with faults
    if not is_loopback:
        warning = (
            "warning: other machines reach the studio, and what is sent is not encrypted; put a TLS proxy before it"
        )
        echo(warning, err=True)
    serve(opened, host, port, draw, echo, not no_browser)
