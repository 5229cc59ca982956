"""Faults in copies of kernels, each of which the check has to find: where, what is there, what is put in its place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """file: of kernels/; old, new: text there; recorded: in the report."""

    name: str
    file: str
    old: str
    new: str
    recorded: str

    @property
    def case(self) -> str:
        """Name of the case that runs into it (tests/oclgrind/cases.py)."""
        return {"inpainting": "solver", "layered": "layers"}.get(self.file.split("/")[0], "tiles")

    @property
    def check(self) -> str:
        """One of `tests.oclgrind.simulator.CHECKS`."""
        return "uninitialized" if self.recorded == "ninitialized" else "races"


LAST_BARRIER = """                        &chunk SUBPIXEL_VALUES);
        barrier(CLK_LOCAL_MEM_FENCE);
"""
FAULTS = (
    Fault(
        "a work-item too many",
        "inpainting/biharmonic.cl",
        "    if (entry >= count)",
        "    if (entry > count)",
        "Invalid read",
    ),
    Fault(
        "a write beyond the end",
        "inpainting/biharmonic.cl",
        "    sums[slot * CHANNELS + c] = sum;",
        "    sums[(slot + 3) * CHANNELS + c] = sum;",
        "Invalid write",
    ),
    Fault(
        "one place for all work-items",
        "inpainting/biharmonic.cl",
        "        applied[entry * CHANNELS + c] = image ? -result[c] : result[c];",
        "        applied[c] = result[c] + entry;",
        "Write-write data race",
    ),
    Fault(
        "the same value written by all",
        "inpainting/biharmonic.cl",
        "        direction[k] = preconditioned[k] + part * direction[k];",
        "        direction[k] = preconditioned[k] + part * direction[k]; direction[0] = 0;",
        "data race",
    ),
    Fault(
        "a private array not set",
        "inpainting/biharmonic.cl",
        "    real sum[CHANNELS] = {0};\n    for (int k",
        "    real sum[CHANNELS];\n    for (int k",
        "ninitialized",
    ),
    Fault(
        "a local array not set",
        "blur/tiles.cl",
        "        if (item < CHUNK / WORD)\n            chunk.reaching[item] = 0;\n",
        "",
        "ninitialized",
    ),
    Fault("a plane not written", "common/sources.clh", "    source[2 * plane + at] = record.z;\n", "", "ninitialized"),
    Fault(
        "no barrier after the chunk",
        "blur/tiles.cl",
        LAST_BARRIER,
        LAST_BARRIER[: LAST_BARRIER.rindex("        b")],
        "data race",
    ),
    Fault(
        "a barrier that not all reach",
        "blur/tiles.cl",
        "            chunk.reaching[item] = 0;\n        barrier(CLK_LOCAL_MEM_FENCE);",
        "        { chunk.reaching[item] = 0; barrier(CLK_LOCAL_MEM_FENCE); }",
        "divergence",
    ),
    Fault(
        "beyond a local array",
        "blur/tiles.cl",
        "        if (item < CHUNK / WORD)\n",
        "        if (item < 64 * CHUNK)\n",
        "exceeds static array size",
    ),
    Fault(
        "a plain load beside an atomic",
        "layered/tiles.clh",
        "if (RELAXED_LOAD(entry) < value)",
        "if (*entry < value)",
        "Read-write data race",
    ),
)
