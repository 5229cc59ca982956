"""Data sets: samples drawn from distributions, the formats that hold them, and the loader."""
