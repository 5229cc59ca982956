"""Devices, sessions, programs and buffers of OpenCL; independent of scenes."""
