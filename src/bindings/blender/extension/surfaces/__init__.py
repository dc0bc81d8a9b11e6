"""From a request to arrays, without Blender: the file of a frame, the inputs of a surface, and a cache of surfaces."""
