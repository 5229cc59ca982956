"""A window in the browser: the five panels of the thesis, alive."""

import os

# NiceGUI would read this folder below the current one, which may be a stranger's; clsco keeps nothing in it.
os.environ.setdefault("NICEGUI_STORAGE_PATH", os.devnull)
