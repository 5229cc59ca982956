"""Plans: passes that render a scene, with their methods and memory; independent of OpenCL."""
