"""The command `clsco check`: compares frames with the reference and with rays, and writes tables or a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clsco.cli.check import Checked, compare_frames
from clsco.cli.output import echo
from clsco.cli.tables import check_tables, judged_tables, print_tables
from clsco.errors import ClscoError
from clsco.files.images import save_image, write_json
from clsco.scene.model import Scene

if TYPE_CHECKING:
    from clsco.truth.judge import Judgement


def require_report(out: Path) -> None:
    """Raise ClscoError if `out` is not a type of file that a report can have."""
    if out.suffix.lower() not in (".json", ".png"):
        raise ClscoError(f"-o: must be a file .json or .png; got {out}")


def check_scene(
    path: Path, scene: Scene, extent: tuple[int, float], out: Path | None, device: str | None, precision: str | None
) -> None:  # fmt: skip
    """Print how every view of a scene differs from the reference and from rays, and write the report to `out`.

    extent: most rays per pixel, and seconds for all of them. Raises ClscoError if a difference is too large.
    """
    rays, seconds = extent
    why = "no rays were asked for" if not rays else None
    if rays:
        from clsco.truth.judge import judge
        from clsco.truth.problem import make_problem, not_judged

        why = not_judged(scene)
    views: list[tuple[Checked, Judgement]] = []
    count = scene.sequence.frames * (1 if scene.stereo is None else 2)
    for checked in compare_frames(scene, device, precision):
        print_tables(*check_tables(checked))
        color, view = checked.differences[0], f" ({checked.eye})" if checked.eye else ""
        if not color.agrees:
            got = f"{color.largest:.2g} in frame {checked.index}{view} ({color.count} pixels above)"
            raise ClscoError(f"{path}: color must agree within {color.figure:g} of white; got {got}")
        if why is None:
            problem = make_problem(scene, checked.index, checked.eye)
            judged = judge(problem, checked.frame.color, rays, seconds / count)
            print_tables(*judged_tables(judged))
            views.append((replace(checked, eye=view), judged))
    if why is not None:
        echo(f"the lens: not judged: {why}")
    if out is not None:
        _write_report(out, views, why)
    if wrong := [f"{judged.wrong} in frame {each.index}{each.eye}" for each, judged in views if not judged.agrees]:
        raise ClscoError(f"{path}: pixels must be within 0.01 of white and 5 errors of rays; got {'; '.join(wrong)}")


def _write_report(out: Path, views: list[tuple[Checked, Judgement]], why: str | None) -> None:
    """Write all figures to a JSON file, or draw the tested pixels on the darkened frames of all views, one below the
    other: red if too bright, blue if too dark, green if they agree; colors saturate at 0.01 of white.
    """
    if out.suffix.lower() == ".json":
        values = [{"frame": each.index, "eye": each.frame.eye} | judged.values() for each, judged in views]
        write_json(out, {"not_judged": why, "views": values})
        return
    if why is not None:
        raise ClscoError(f"-o: a picture needs rays; got {why}")
    pictures = []
    for each, judged in views:
        light = np.clip(each.frame.color.reshape(*each.frame.color.shape[:2], -1).mean(axis=2), 0.0, 1.0)
        picture = np.repeat(0.25 * light[..., None], 3, axis=2)
        off = (judged.got - judged.right).mean(axis=1) / 0.01
        tried = np.stack([off, 1.0 - np.abs(off), -off], axis=-1)
        picture[judged.pixels.row, judged.pixels.column] = np.clip(tried, 0.0, 1.0)
        pictures.append(picture.astype(np.float32))
    save_image(out, np.concatenate(pictures), 8)
