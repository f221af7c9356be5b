"""Which large bone a place on the skin belongs to."""

from __future__ import annotations

from soar.body.record import BodyModel
from soar.errors import ModelFileError

BONES = (
    "head", "neck01", "spine04", "root", "upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot"
)  # fmt: skip
"""The large bones, without the ``.L`` or ``.R`` of their side; each stands for all smaller ones that hang on it."""

_OTHERS = {"pelvis": "root", "spine1": "spine04", "neck": "neck01"} | {
    f"{side}_{joint}": f"{bone}.{side[0].upper()}"
    for side in ("left", "right")
    for joint, bone in (
        ("shoulder", "upperarm01"), ("elbow", "lowerarm01"), ("wrist", "wrist"),
        ("hip", "upperleg01"), ("knee", "lowerleg01"), ("ankle", "foot"),
    )
}  # fmt: skip
"""What SMPL-X calls them; a bone goes from the joint it is called by."""


def bone_name(joint: str) -> str:
    """What the default body calls the bone at a joint; the joint's own name where that is no large one."""
    return _OTHERS.get(joint, joint)


def without_side(name: str) -> str:
    """A joint's name without the ``.L`` or ``.R``."""
    return name.removesuffix(".L").removesuffix(".R")


def bones_of_vertices(body: BodyModel) -> tuple[str, ...]:
    """Of each of the V vertices the nearest ancestor, among the large bones, of its heaviest bone; with its side.

    Raises:
        ModelFileError: the skeleton's bones are called otherwise.
    """
    names, parents = [bone_name(joint) for joint in body.joint_names], body.parents.tolist()
    missing = [bone for bone in BONES if bone not in set(map(without_side, names))]
    if missing or without_side(names[0]) not in BONES:
        raise ModelFileError(
            f"the parts of the body model {body.name} are not known",
            expected=f"a skeleton whose bones are called {', '.join(BONES)}",
            got=f"none called {', '.join(missing)}" if missing else f"a skeleton that starts with {names[0]}",
            cure="use the body model Anny or SMPL-X",
        )
    large: list[str] = []  # of each joint; a parent precedes its children
    for name, parent in zip(names, parents, strict=True):
        large.append(name if without_side(name) in BONES else large[parent])
    return tuple(large[joint] for joint in body.weights.argmax(1).tolist())
