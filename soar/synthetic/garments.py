"""The cut of every garment, shoe and head of hair, as ranges of :class:`~soar.synthetic.records.Cloth` fields.

Heights are given from an anchor of the mean shape (``low=("waist", -0.2, -0.1)``). Names are what families weigh.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from soar.synthetic.records import NO_PRINT, Anchors, Cloth, Pattern, PatternKind

Cut = Mapping[str, Any]

_BLANK: dict[str, Any] = {
    "thickness": 0.006, "flare": 0.0, "flare_range": 0.3, "bumps": 0.0, "bump_length": 0.1, "low": -9.0, "high": 9.0,
    "sleeve": 9.0, "neck": 9.0, "neck_slope": 0.4, "vee": 0.0, "strap": 0.0, "opening": 0.0, "spread": 0.0,
    "crease": 0.0, "gloss": 0.03, "grain": (0.05, 0.15), "rim": 0.0, "rim_width": 0.0, "collar": 0.0,
    "seams": (0.1, 0.3), "pockets": 0.0, "buttons": 0.0, "belt": 0.0, "sole": 0.0, "laces": 0.0,
}  # fmt: skip
_CREW = {"neck": ("neck", -0.025, 0.0), "neck_slope": (0.25, 0.4)}
_TOP = {**_CREW, "thickness": (0.005, 0.009), "flare": (0.004, 0.02), "bumps": (0.002, 0.006),
        "low": ("waist", -0.24, -0.14), "rim": (0.0, 0.5), "rim_width": (0.012, 0.022)}  # fmt: skip
_LONG = {"sleeve": (0.50, 0.555)}

TOPS: dict[str, Cut | None] = {
    "none": None,
    "tee": {**_TOP, "sleeve": (0.11, 0.21)},
    "longsleeve": {**_TOP, **_LONG, "bumps": (0.003, 0.007)},
    "shirt": {**_TOP, **_LONG, "neck": ("neck", -0.03, 0.0), "vee": (0.0, 0.04), "collar": (0.02, 0.035),
              "buttons": 1.0, "rim": 0.0, "bumps": (0.003, 0.008)},
    "polo": {**_TOP, "sleeve": (0.13, 0.2), "collar": (0.02, 0.03), "vee": (0.02, 0.05)},
    "sweater": {**_TOP, **_LONG, "thickness": (0.009, 0.015), "bumps": (0.004, 0.010), "grain": (0.15, 0.3),
                "rim": (0.2, 0.8), "rim_width": (0.03, 0.05)},
    "tank": {**_TOP, "neck": ("neck", -0.07, -0.04), "neck_slope": (0.3, 0.45), "sleeve": (0.02, 0.03),
             "strap": (0.095, 0.125)},
    "turtleneck": {**_TOP, **_LONG, "neck": ("neck", 0.035, 0.05), "neck_slope": (0.25, 0.35),
                   "rim_width": (0.03, 0.04)},
    "vneck": {**_TOP, "sleeve": (0.25, 0.40), "vee": (0.06, 0.11)},
    "crop": {**_TOP, "low": ("waist", 0.03, 0.10), "sleeve": (0.06, 0.12), "neck": ("neck", -0.06, -0.03)},
}  # fmt: skip

_LEG = {"thickness": (0.006, 0.010), "flare": (0.004, 0.016), "bumps": (0.002, 0.006), "high": ("waist", -0.09, -0.02),
        "flare_range": (0.2, 0.5)}  # fmt: skip
_FULL = {"low": ("ankle", 0.0, 0.04)}
BOTTOMS: dict[str, Cut] = {
    "trousers": {**_LEG, **_FULL, "belt": (-0.06, 0.04)},
    "jeans": {**_LEG, **_FULL, "pockets": 1.0, "seams": (0.3, 0.5), "belt": (-0.02, 0.04), "grain": (0.2, 0.35)},
    "shorts": {**_LEG, "low": ("knee", 0.03, 0.24), "flare": (0.008, 0.025), "flare_range": (0.15, 0.3)},
    "skirt": {"thickness": (0.006, 0.010), "flare": (0.0, 0.03), "bumps": (0.004, 0.014), "bump_length": (0.05, 0.09),
              "low": ("knee", -0.18, 0.16), "high": ("waist", -0.08, -0.04)},
    "leggings": {**_LEG, **_FULL, "thickness": 0.003, "flare": 0.0, "bumps": (0.0, 0.001)},
    "capri": {**_LEG, "low": ("knee", -0.30, -0.16), "pockets": 1.0},
    "flares": {**_LEG, **_FULL, "flare": (0.028, 0.040), "flare_range": (0.6, 0.7), "belt": (0.03, 0.05)},
    "miniskirt": {"thickness": (0.006, 0.010), "flare": (0.0, 0.02), "bumps": (0.003, 0.010),
                  "bump_length": (0.05, 0.08), "low": ("knee", 0.20, 0.26), "high": ("waist", -0.09, -0.05)},
    "gown": {"thickness": (0.006, 0.012), "flare": (0.02, 0.05), "bumps": (0.006, 0.018), "bump_length": (0.06, 0.1),
             "low": ("ankle", 0.06, 0.2), "high": ("waist", -0.06, -0.03)},
}  # fmt: skip
SKIRTS = ("skirt", "miniskirt", "gown")

_COAT = {**_LONG, **_CREW, "thickness": (0.016, 0.022), "flare": (0.006, 0.020), "bumps": (0.004, 0.010),
         "low": ("waist", -0.26, -0.12), "rim": (0.2, 0.9), "rim_width": (0.015, 0.04), "seams": (0.2,
         0.5)}  # fmt: skip
JACKETS: dict[str, Cut | None] = {
    "none": None,
    "closed": {**_COAT, "buttons": 2.0, "collar": (0.02, 0.05)},
    "open": {**_COAT, "opening": (0.02, 0.06), "spread": (0.0, 0.12), "collar": (0.0, 0.05), "pockets": (-1.0, 1.0)},
    "bomber": {**_COAT, "low": ("waist", -0.10, -0.06), "buttons": 2.0, "rim": 0.9, "rim_width": (0.04, 0.06)},
    "cardigan": {**_COAT, "opening": (0.01, 0.03), "spread": (0.12, 0.3), "low": ("waist", -0.4, -0.3),
                 "grain": (0.2, 0.3)},
    "waistcoat": {**_COAT, "sleeve": (0.0, 0.01), "strap": (0.13, 0.15), "opening": (0.02, 0.05), "spread": (0.0, 0.08),
                  "low": ("waist", -0.16, -0.10)},
}  # fmt: skip

_SHOE = {"thickness": (0.008, 0.011), "bumps": (0.0, 0.002), "high": ("ankle", -0.02, 0.01), "sole": (0.018, 0.032),
         "gloss": (0.03, 0.25), "seams": 0.0}  # fmt: skip
FOOTWEAR: dict[str, Cut | None] = {
    "bare": None,
    "socks": {
        "thickness": 0.003,
        "high": ("ankle", 0.05, 0.24),
        "grain": (0.1, 0.2),
        "rim": 0.5,
        "rim_width": 0.02,
        "seams": 0.0,
    },
    "shoes": {**_SHOE, "gloss": (0.15, 0.35)},
    "trainers": {**_SHOE, "laces": 1.0, "high": ("ankle", -0.01, 0.02), "rim": (0.0, 1.0), "rim_width": (0.01, 0.02)},
    "boots": {**_SHOE, "high": ("ankle", 0.12, 0.24), "gloss": (0.1, 0.3), "thickness": (0.010, 0.014)},
    "slippers": {**_SHOE, "high": ("ankle", -0.03, -0.02)},
}

_HAIR = {"gloss": (0.05, 0.2), "grain": 0.0, "seams": 0.0}
# Of hair: the scalp's cut, the long locks' (or None), and fields of Person.
HAIR: dict[str, Cut | None] = {
    "bald": None,
    "buzz": {**_HAIR, "thickness": (0.001, 0.003)},
    "short": {**_HAIR, "thickness": (0.011, 0.020), "bumps": (0.002, 0.005), "bump_length": (0.02, 0.04)},
    "full": {**_HAIR, "thickness": (0.020, 0.036), "bumps": (0.004, 0.010), "bump_length": (0.025, 0.05)},
    "bob": {**_HAIR, "thickness": (0.014, 0.020), "bumps": (0.002, 0.005), "bump_length": (0.03, 0.05)},
    "long": {**_HAIR, "thickness": (0.012, 0.018), "bumps": (0.002, 0.005), "bump_length": (0.03, 0.05)},
    "afro": {**_HAIR, "thickness": (0.045, 0.075), "bumps": (0.004, 0.008), "bump_length": (0.02, 0.03)},
    "receding": {**_HAIR, "thickness": (0.005, 0.010), "bumps": (0.001, 0.003), "bump_length": (0.02, 0.04)},
    "waves": {**_HAIR, "thickness": (0.016, 0.024), "bumps": (0.006, 0.012), "bump_length": (0.03, 0.05)},
    "cap": {**_HAIR, "thickness": (0.005, 0.009), "bumps": (0.001, 0.003), "bump_length": (0.02, 0.04)},
    "beanie": {**_HAIR, "thickness": (0.005, 0.009), "bumps": (0.001, 0.003), "bump_length": (0.02, 0.04)},
}
LOCKS: dict[str, Cut] = {
    "bob": {**_HAIR, "low": ("chin", -0.04, 0.02), "thickness": 0.004, "bumps": (0.004, 0.010),
            "bump_length": (0.04, 0.06)},
    "long": {**_HAIR, "low": ("chin", -0.34, -0.10), "thickness": 0.004, "bumps": (0.006, 0.014),
             "bump_length": (0.05, 0.08)},
    "waves": {**_HAIR, "low": ("chin", -0.22, -0.08), "thickness": 0.006, "bumps": (0.016, 0.024),
              "bump_length": (0.03, 0.05)},
}  # fmt: skip
CAPS: dict[str, Cut] = {
    "cap": {"thickness": (0.012, 0.016), "low": ("crown", -0.085, -0.07), "seams": 0.2, "rim": 0.3, "rim_width": 0.01},
    "beanie": {"thickness": (0.014, 0.020), "low": ("crown", -0.095, -0.08), "bumps": (0.002, 0.006),
               "bump_length": 0.05, "grain": 0.3,
               "rim": 0.4, "rim_width": (0.02, 0.035)},
}  # fmt: skip

_NONE_PATTERN = Pattern(PatternKind.PLAIN, 1.0, 0.5, 0.0, 0.0, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3)
NOT_WORN = Cloth(
    **{"worn": 0.0, **dict.fromkeys(_BLANK, 0.0), "flare_range": 1.0, "bump_length": 1.0},
    front=_NONE_PATTERN, back=_NONE_PATTERN, chest=NO_PRINT, spine=NO_PRINT, trim=(0.0,) * 3, metal=(0.0,) * 3,
        seed=(0.0,) * 3,
)  # fmt: skip


def tailored(cut: Cut, anchors: Anchors, rng: np.random.Generator, **fields: Any) -> Cloth:
    """A garment of this cut: ranges drawn, heights put to their anchors; ``fields`` are taken as they are."""
    values = {}
    for name, blank in _BLANK.items():
        value = cut.get(name, blank)
        if isinstance(value, tuple) and isinstance(value[0], str):
            value = getattr(anchors, value[0]) + rng.uniform(*value[1:])
        elif isinstance(value, tuple):
            value = rng.uniform(*value)
        values[name] = float(value)
    seed = tuple(rng.uniform(0, 50, 3).tolist())
    return Cloth(**{"worn": 1.0, "seed": seed, "chest": NO_PRINT, "spine": NO_PRINT, **values, **fields})
