"""The command as a process of its own, which starts fast, and ends as soon as its work is done."""

from __future__ import annotations

import atexit
import gc
import os
import sys
import threading
from contextlib import suppress

from clsco.cli.main import main

_OBJECTS = 50_000
"""So many more than there were have Python look for cycles of them: imports make many objects, and no garbage."""


def run() -> None:
    """Run the command line, and end the process.

    Modules are imported when a command needs them. Meanwhile Python would look for garbage a hundred times, and
    pydantic for plug-ins in all installed packages.

    Python and PoCL take a tenth of the first frame's time to take themselves apart (benchmarks/optimisation_log.md).
    So the process ends when what was to be done at its end is done, unless a thread still works or a stream cannot be
    written.
    """
    gc.set_threshold(_OBJECTS)
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    try:
        main()
    except SystemExit as ended:
        if not isinstance(ended.code, int) or threading.active_count() > 1:
            raise
        with suppress(OSError):  # which Python reports at an exit
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
            atexit._run_exitfuncs()
            os._exit(ended.code)
        raise
