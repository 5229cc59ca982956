"""Filling of missing pixels: rules, tables and one module for each method."""
