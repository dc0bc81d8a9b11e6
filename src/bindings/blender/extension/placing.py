"""Puts objects in the place of other objects, with the same transform, parent, constraints and animation."""

from __future__ import annotations

import bpy

#: The properties that determine an object's transform. The parent comes first, because the
#: location, the rotation and the scale are relative to the parent.
_TRANSFORM = (
    "parent", "parent_type", "parent_bone", "parent_vertices", "matrix_parent_inverse", "rotation_mode",
    "location", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale",
    "delta_location", "delta_rotation_euler", "delta_rotation_quaternion", "delta_scale",
)


def place(context: bpy.types.Context, added: bpy.types.Object, of: bpy.types.Object) -> None:
    """Moves the object `added` to the place of the object `of`, and into the collections of `of`."""
    for collection in added.users_collection:
        collection.objects.unlink(added)
    for collection in of.users_collection:
        collection.objects.link(added)
    for name in _TRANSFORM:
        setattr(added, name, getattr(of, name))
    added.constraints.clear()
    for constraint in of.constraints:
        added.constraints.copy(constraint)
    if of.animation_data is not None:
        with context.temp_override(object=of, active_object=of, selected_editable_objects=[added]):
            bpy.ops.object.make_links_data(type="ANIMATION")
        # The operator also copies the animation of the mesh `of.data`, which sets the options of
        # the live surface. The added mesh must not have this animation.
        added.data.animation_data_clear()
