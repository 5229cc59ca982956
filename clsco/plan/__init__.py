"""From a scene to the passes that render it, with their methods and memory; without OpenCL."""
