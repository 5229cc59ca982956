"""OpenCL: devices, sessions, programs and buffers; independent of scenes."""
