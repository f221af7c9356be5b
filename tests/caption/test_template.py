"""The measured caption: people in known clothes, in light and shade, partly seen, and masked."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from soar.caption.records import Caption
from soar.caption.regions import NOWHERE, REGIONS, RegionFinder
from soar.caption.registry import caption_provider
from soar.caption.template import sentence, with_article
from soar.errors import ModelFileError
from soar.raster import RasterSettings
from tests.caption import people
from tests.caption.people import SKIN, Outfit
from tests.conftest import conf

RASTER = RasterSettings(1 / 12, True, True, "auto")
BLUE, BLACK, WHITE, RED, GREEN, BROWN = (
    (20, 110, 160), (18, 18, 18), (238, 238, 238), (185, 30, 40), (50, 130, 60), (95, 62, 42),
)  # fmt: skip


def wearing(
    top: tuple[int, int, int] | None = None,
    legs: tuple[int, int, int] | None = None,
    feet: tuple[int, int, int] = SKIN,
    hair: tuple[int, int, int] = SKIN,
    sleeve: float = 0.0,
    leg: float = 2.0,
) -> Outfit:
    """Clothes by colour; sleeve and leg reach so many bones down: 1 is to elbow and knee, 2 to wrist and ankle."""

    def colour(bone: str, share: float) -> tuple[int, int, int]:
        before = {"upperarm01": 0, "lowerarm01": 1, "upperleg01": 0, "lowerleg01": 1}.get(bone, 0)
        if bone == "head":
            return hair if share < 0.3 else SKIN
        if bone == "spine04" and top:
            return top
        if bone == "root":
            return legs if legs and share > 0.7 else top or SKIN
        if bone.endswith("arm01") and top and before + share < sleeve:
            return top
        if bone.endswith("leg01") and legs and before + share < leg:
            return legs
        return feet if bone == "foot" else SKIN

    return colour


def described(outfit: Outfit, **how: object) -> Caption:
    return caption_provider(conf("caption", "template"), RASTER).caption(people.footage(outfit, **how))


@pytest.mark.parametrize(
    ("outfit", "text"),
    [
        (
            wearing(hair=BLUE, legs=BLACK, leg=0.8),
            "A person with a blue cap, bare-chested, black shorts, bare feet.",
        ),
        (
            wearing(RED, (28, 38, 80), WHITE, BROWN, sleeve=2),
            "A person with brown hair, a long-sleeved red top, dark blue trousers, white shoes.",
        ),
        (
            wearing(GREEN, None, BLACK, sleeve=0.7),
            "A person with a bald head, a short-sleeved green top, bare legs, black shoes.",
        ),
        (
            wearing(WHITE, RED, GREEN, BLACK, leg=1.5),
            "A person with black hair, a sleeveless white top, red cropped trousers, green shoes.",
        ),
    ],
)
def test_people_in_known_clothes(outfit: Outfit, text: str) -> None:
    caption = described(outfit)
    assert caption.text == text
    assert caption.numbers == {"parts": 4}
    assert not caption.remarks
    assert caption.evidence["lower"]["colours"][0]["share"] > 0.5


def test_dim_light_changes_no_word() -> None:
    outfit = wearing(RED, BLUE, BLACK, BLACK, sleeve=2)
    assert described(outfit, light=0.6).text == described(outfit).text


def test_a_top_of_the_colour_of_skin_hides_no_shorts() -> None:
    plain = wearing(None, BLUE, BLACK, BROWN, leg=0.9)
    caption = described(lambda bone, share: SKIN if bone == "upperleg01" and share < 0.15 else plain(bone, share))
    assert caption.evidence["lower"]["words"] == "blue shorts"


def test_the_belly_alone_makes_no_top() -> None:
    plain = wearing(None, BLUE, BLACK, BROWN)
    caption = described(lambda bone, share: RED if bone == "root" else plain(bone, share))
    assert caption.evidence["upper"]["words"] == "bare-chested"


def test_stripes_have_both_colours() -> None:
    plain = wearing(RED, BLUE, BLACK, BROWN)

    def striped(bone: str, share: float) -> tuple[int, int, int]:
        return WHITE if bone.endswith("leg01") and int(share * 20) % 2 else plain(bone, share)

    words = described(striped).evidence["lower"]["words"]
    assert words in ("blue and white trousers", "white and blue trousers")


def test_what_is_not_in_the_picture_is_not_spoken_of() -> None:
    caption = described(wearing(RED, BLUE, BLACK, BROWN, sleeve=2), rows=slice(0, 185))
    assert caption.text == "A person with brown hair, a long-sleeved red top, blue legwear."
    assert "feet" in caption.remarks[0]


def test_without_skin_to_compare_nothing_is_bare() -> None:
    caption = described(lambda bone, share: BLUE)
    assert caption.text == "A person with a blue cap, a blue top, blue legwear, blue shoes."
    assert "Neither face nor hands show skin" in caption.remarks[-1]
    assert caption.evidence["skin"] == []


def test_nobody_to_be_seen() -> None:
    caption = described(wearing(RED), rows=slice(0, 10))
    assert caption.text == "A person."
    assert caption.numbers["parts"] == 0


def test_pictures_show_what_was_measured() -> None:
    footage = people.footage(wearing(RED, BLUE, BLACK, BROWN, sleeve=2))
    caption = caption_provider(conf("caption", "template"), RASTER).caption(footage)
    for picture, sighting in zip(caption.pictures, footage.sightings, strict=True):
        assert picture.shape == sighting.rgb.shape
        drawn = (picture < 1).any(-1)
        assert drawn.sum() > 0.3 * (sighting.alpha > 127).sum()
        assert np.abs(255 * picture[drawn] - sighting.rgb[drawn]).mean() < 30
    assert [swatch.words for swatch in caption.swatches][:2] == ["brown hair", "a long-sleeved red top"]


def test_regions_lie_on_the_person_and_apart() -> None:
    (sighting,) = people.footage(wearing(), frames=1).sightings
    found = RegionFinder(people.body(), 0.004, 0.03, "auto")(sighting)
    assert set(np.unique(found)) >= {NOWHERE, *map(REGIONS.index, ("face", "chest", "belly", "feet", "leg 0", "arm 5"))}
    assert (found[sighting.alpha == 0] == NOWHERE).all()
    middle = {
        region: np.nonzero(found == REGIONS.index(region))[0].mean() for region in ("top of head", "face", "feet")
    }
    assert middle["top of head"] < middle["face"] < middle["feet"]
    # The body stands where the mask is not: nothing is measured.
    aside = dataclasses.replace(sighting, vertices=sighting.vertices + 50)
    assert (RegionFinder(people.body(), 0.004, 0.03, "auto")(aside) == NOWHERE).all()


def test_a_skeleton_with_other_names_is_refused() -> None:
    model = people.body()
    other = dataclasses.replace(model, joint_names=tuple(name.replace("foot", "ankle") for name in model.joint_names))
    with pytest.raises(ModelFileError, match="foot"):
        RegionFinder(other, 0.004, 0.03, "auto")


def test_grammar() -> None:
    assert with_article("orange cap") == "an orange cap"
    assert with_article("blue cap") == "a blue cap"
    assert sentence(["bare-chested", "blue shorts"]) == "A person, bare-chested, blue shorts."
