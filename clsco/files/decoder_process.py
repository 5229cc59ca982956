"""Runs untrusted decoders, such as those of TIFF and HDF5, in a child process with memory and CPU limits.

The process starts at the first call, is restarted after a limit or a crash, and ends with its parent.
"""

from __future__ import annotations

import atexit
import importlib
import json
import math
import os
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from clsco.resources import open_regular

if TYPE_CHECKING:
    import subprocess

MEMORY = 2**28  # bytes of memory that any decoder may use
FACTOR = 4  # further memory of a decoder, as a multiple of the bytes of its arrays
SECONDS, RATE = 20.0, 2**25  # s of CPU time for any decoder, and bytes of arrays for each further second
PATIENCE = 6  # wall-clock limit, as a multiple of the CPU limit: the processor may have other work
_ROOT = Path(__file__).resolve().parents[2]  # folder with this package; the current folder may have another clsco
_COMMAND = "from clsco.files.decoder_process import serve; serve()"
_PIPE = 2**20  # bytes of a pipe's buffer, if the system supports it
_MOST_LINE = 2**24  # bytes of a reply without its arrays

Output = tuple[dict[str, Any], list[NDArray[Any]]]


class _Serving:
    """The decoder process of this process, if any, and a lock for its callers."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> subprocess.Popen[bytes]:
        if self.process is None:
            import subprocess  # 4 ms, and most commands read no such file

            path = os.pathsep.join(filter(None, (str(_ROOT), os.environ.get("PYTHONPATH"))))
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", _COMMAND], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL, pipesize=_PIPE,
                start_new_session=True,  # otherwise Ctrl-C would end it before its parent
                env={**os.environ, "PYTHONPATH": path, "MALLOC_ARENA_MAX": "1"},
            )  # fmt: skip
        return self.process

    def end(self) -> int | None:
        """End the process; returns its status, negative for a signal."""
        process, self.process = self.process, None
        if process is None:
            return None
        with suppress(OSError), process:  # closes the pipes, and waits for its end
            pass
        return process.returncode

    def forget(self) -> None:
        """Forget the process in a forked child: it belongs to the parent."""
        if self.process is not None:
            self.process.returncode = 0
        self.__init__()  # type: ignore[misc]


_serving = _Serving()
atexit.register(_serving.end)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_serving.forget)


def run_decoder(function: str, file: BinaryIO, most: int, **options: Any) -> Output:
    """Call a function in the decoder process, and return its result.

    function: "module:name". The function takes the file, opened again at its first byte, and JSON-compatible `options`;
    it returns a JSON-compatible mapping and arrays. most: bytes of all arrays together, from which limits follow.
    Raises ValueError if the function fails, crashes the process, or exceeds a limit.
    """
    about, seconds = os.fstat(file.fileno()), SECONDS + most / RATE
    memory = MEMORY + FACTOR * most
    request = {
        "function": function, "path": str(Path(file.name).absolute()), "file": [about.st_dev, about.st_ino],
        "memory": memory, "seconds": seconds, "options": options,
    }  # fmt: skip
    with _serving.lock:
        process = _serving.start()
        killer = threading.Timer(PATIENCE * seconds, process.kill)
        killer.daemon = True
        killer.start()
        try:
            answer = _exchange(process, json.dumps(request).encode(), most)
        except (EOFError, OSError):
            status = _serving.end()
            limits = f"{memory >> 20} MiB and {seconds:.0f} s"
            raise ValueError(f"a decoder that ended with status {status}, allowed {limits}") from None
        except BaseException:
            process.kill()  # otherwise the next call would read the rest of this answer
            _serving.end()
            raise
        finally:
            killer.cancel()
    if isinstance(answer, str):
        raise ValueError(answer)
    return answer


def _exchange(process: subprocess.Popen[bytes], request: bytes, most: int) -> Output | str:
    """Send a request and read the answer; a str is an error message. Raises EOFError if the process ends."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(request + b"\n")
    process.stdin.flush()
    line = process.stdout.readline(_MOST_LINE)
    if not line:
        raise EOFError
    reply = json.loads(line)
    if "error" in reply:
        return str(reply["error"])
    kinds = [(np.dtype(kind), tuple(map(int, shape))) for kind, shape in reply["arrays"]]
    if sum(kind.itemsize * math.prod(shape) for kind, shape in kinds) > most:
        raise ValueError(f"arrays of more than {most} bytes")
    arrays = [np.empty(shape, kind) for kind, shape in kinds]
    for array in arrays:
        left = _bytes(array)
        while len(left):
            if not (count := process.stdout.readinto(left)):  # type: ignore[attr-defined]
                raise EOFError
            left = left[count:]
    return reply["facts"], arrays


def _bytes(array: NDArray[Any]) -> memoryview:
    return array.reshape(-1).view(np.uint8).data


def serve() -> None:
    """Answer calls on stdin until it is closed."""
    threading.stack_size(2**20)  # stacks of the decoders' threads count as memory
    calls, answers = sys.stdin.buffer, sys.stdout.buffer
    while line := calls.readline():
        try:
            reply, arrays = _call_function(json.loads(line))
        except MemoryError:
            reply, arrays = {"error": "more memory than its size allows"}, []
        except Exception as error:
            reply, arrays = {"error": " ".join(str(error).split()) or type(error).__name__}, []
        else:
            reply = {"facts": reply, "arrays": [(array.dtype.str, array.shape) for array in arrays]}
        answers.write(json.dumps(reply).encode() + b"\n")
        for array in arrays:
            answers.write(_bytes(np.ascontiguousarray(array)))
        answers.flush()
        del arrays


def _call_function(call: Mapping[str, Any]) -> Output:
    module, _, name = call["function"].partition(":")
    _unlimit()  # limits are for the decoder, not for imports
    function = getattr(importlib.import_module(module), name)
    _limit(call["memory"], call["seconds"])
    with open_regular(call["path"], follow=True) as file:
        about = os.fstat(file.fileno())
        if [about.st_dev, about.st_ino] != call["file"]:
            raise ValueError("another file than was opened first")
        result: tuple[dict[str, Any], Sequence[NDArray[Any]]] = function(file, **call["options"])
        return result[0], list(result[1])


def _limit(memory: int, seconds: float) -> None:
    """Limit what this process may use from now on, if the system supports it; memory: bytes; seconds: CPU time."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        _soft(resource.RLIMIT_CORE, 0)
        _soft(resource.RLIMIT_CPU, math.ceil(time.process_time() + seconds))
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        _soft(resource.RLIMIT_AS, pages * resource.getpagesize() + memory)


def _unlimit() -> None:
    with suppress(ImportError, OSError, ValueError):
        import resource

        for kind in (resource.RLIMIT_AS, resource.RLIMIT_CPU):
            _soft(kind, resource.getrlimit(kind)[1])


def _soft(kind: int, limit: int) -> None:
    import resource

    resource.setrlimit(kind, (limit, resource.getrlimit(kind)[1]))
