"""Devices, sessions, programs and buffers. Knows no scenes."""
