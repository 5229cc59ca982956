"""A window in the browser: the five panels of the thesis, alive."""
