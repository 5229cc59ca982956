"""Data sets: many samples drawn from one distribution file, and the containers that they are stored in."""
