"""A key of a mesh's content, to find copies: large files often repeat a few meshes."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from hulldown.reading.blender.arrays import read

# By type of attribute: the property of its elements, how they are stored, how many numbers each.
STORED = {
    "FLOAT": ("value", np.float32, 1),
    "INT": ("value", np.int32, 1),
    "BOOLEAN": ("value", np.bool_, 1),
    "INT8": ("value", np.int32, 1),
    "FLOAT_VECTOR": ("vector", np.float32, 3),
    "FLOAT2": ("vector", np.float32, 2),
    "FLOAT_COLOR": ("color", np.float32, 4),
    "BYTE_COLOR": ("color", np.float32, 4),
    "QUATERNION": ("value", np.float32, 4),
    "FLOAT4X4": ("value", np.float32, 16),
    "INT16_2D": ("value", np.int32, 2),
    "INT32_2D": ("value", np.int32, 2),
}


def content_of(mesh: Any) -> object:
    """Return a key that two meshes share only if they're drawn alike with the same materials.

    The key is the mesh itself if it has content that isn't compared: a text attribute, a custom property, a library; or
    if it's damaged.
    """
    if mesh.library or mesh.override_library or mesh.keys():
        return mesh
    stored = hashlib.sha256()
    try:
        stored.update(read(mesh.polygons, "loop_start", np.int32).tobytes())
    except TypeError:  # in a damaged file, faces may have no corners
        return mesh
    kinds = []
    for attribute in sorted(mesh.attributes, key=lambda attribute: str(attribute.name)):
        if attribute.data_type not in STORED:
            return mesh
        values = read(attribute.data, *STORED[attribute.data_type])
        stored.update(values.tobytes())
        kinds.append((attribute.name, attribute.domain, attribute.data_type, len(values)))
    own_space = None if mesh.use_auto_texspace else (*mesh.texspace_location, *mesh.texspace_size)
    return (
        *(tuple(kinds), stored.digest(), own_space, mesh.texco_mesh, mesh.attributes.default_color_name),
        tuple((layer.name, layer.active_render) for layer in mesh.uv_layers),
    )
