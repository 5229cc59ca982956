"""Cost of the picture at rest, in a line."""

from __future__ import annotations

from clsco.plan.memory import device_bytes
from clsco.plan.prepare import Prepared


def plan_line(prepared: Prepared, seconds: float) -> str:
    """Kinds of passes, time, and memory on the device: "3 passes, 41 ms, 15 MiB".

    Parameters
    ----------
    prepared : Prepared
        As `clsco plan` has it; of a stereo pair both views count.
    seconds : float
        Time that the frame took.
    """
    count = len({step.kind for plan in prepared.plans for step in plan.passes})
    memory = device_bytes(prepared.plan, len(prepared.plans)) / 2**20
    time = f"{1000 * seconds:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"
    return f"{count} pass{'es' if count > 1 else ''}, {time}, {memory:.0f} MiB"
