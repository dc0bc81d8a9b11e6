"""The part of the extension that needs no Blender: it finds a frame's file, and computes and caches surfaces."""
