"""From what is asked for to arrays, without Blender: which file a frame is, what a surface depends on, and what is kept of those that were made."""
