"""Fixture of all tests of this folder: no kernel writes beyond its buffers."""

from tests.edges import edges as edges
