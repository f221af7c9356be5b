"""The native steps dress, pose and draw: structs, signatures, and the check that both sides mean the same record."""

from __future__ import annotations

import ctypes
import functools
from ctypes import POINTER, c_float, c_int, c_int32, c_int64, c_void_p

from soar.raster.library import library


class Geometry(ctypes.Structure):
    """Static record of points, layers and anchors (``people.h``)."""

    _fields_ = (
        *((name, c_int32) for name in ("points", "joints", "betas", "vertices", "triangles", "groups", "capsules",
            "creases")),
        *(
            (name, c_void_p)
            for name in (
                "template", "shapedirs", "bone_begin", "bones", "weights", "joint_template", "joint_shapedirs",
                "parents", "group_point", "group_triangle", "group_corners", "layer_group", "layer_vertex",
                "layer_triangle", "corners", "attributes", "capsule_joints", "capsule_shape", "crease_joint",
                "crease_place", "anchors",
            )
        ),
    )  # fmt: skip


class Dress(ctypes.Structure):
    """Points of the person's shape; per layer vertex, where the layer is kept and how far it is pushed out."""

    _fields_ = tuple((name, c_void_p) for name in ("rest", "kept", "push"))


class Posed(ctypes.Structure):
    """Per layer vertex: place, normal, light that arrives, folds."""

    _fields_ = tuple((name, c_void_p) for name in ("vertices", "normals", "sky", "shadow", "crease"))


class View(ctypes.Structure):
    """A camera and its samples per side of a pixel."""

    _fields_ = (
        *((name, c_float) for name in ("fx", "fy", "cx", "cy")),
        ("T", c_float * 12),
        *((name, c_int32) for name in ("width", "height", "samples")),
    )


class Maps(ctypes.Structure):
    """Planes to draw; null ones are left out."""

    _fields_ = tuple(
        (name, c_void_p)
        for name in ("colour", "normal", "alpha", "depth", "skin_normal", "skin_alpha", "skin_depth", "place", "layer")
    )


RECORDS = ("Anchors", "Person", "Cloth", "Light")


@functools.cache
def people() -> ctypes.CDLL:
    """The native library with the signatures of its people.

    Raises:
        ConfigError: there is no native library; people have no slow twin.
    """
    lib = library()
    lib.soar_people_sizes.restype, lib.soar_people_sizes.argtypes = None, [c_void_p]
    lib.soar_people_dress.restype = c_int
    lib.soar_people_dress.argtypes = [POINTER(Geometry), c_void_p, c_void_p, Dress]
    lib.soar_people_pose.restype = c_int
    lib.soar_people_pose.argtypes = [POINTER(Geometry), c_void_p, Dress, c_void_p, c_void_p, c_void_p, c_void_p, Posed]
    lib.soar_people_draw.restype = c_int
    lib.soar_people_draw.argtypes = [
        POINTER(Geometry), c_void_p, Dress, Posed, c_void_p, POINTER(View), POINTER(Maps), POINTER(Maps), c_int,
    ]  # fmt: skip
    structs = [ctypes.sizeof(struct) for struct in (Geometry, View, Maps)]
    if record_sizes(lib)[len(RECORDS) :] != structs:
        raise AssertionError(f"people.h and native.py disagree: {record_sizes(lib)}, {structs}")
    return lib


def record_sizes(lib: ctypes.CDLL) -> list[int]:
    """Floats of each of :data:`RECORDS`, then bytes of Geometry, View and Maps, as the library has them."""
    sizes = (c_int64 * (len(RECORDS) + 3))()
    lib.soar_people_sizes(ctypes.addressof(sizes))
    return list(sizes)
