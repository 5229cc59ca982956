"""Plans: the passes that render a scene, with their methods and buffers; independent of OpenCL."""
