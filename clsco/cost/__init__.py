"""Prediction of the time that a frame takes: what its passes work on, and how long that takes."""
