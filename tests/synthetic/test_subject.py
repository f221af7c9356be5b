"""Who is drawn: determinism, families without anything in common, and how much people vary."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from soar.errors import ConfigError
from soar.synthetic.records import PatternKind, PrintKind, pack
from soar.synthetic.scene import People
from soar.synthetic.subject import Subject
from tests.synthetic.conftest import SETTINGS

FAMILIES = SETTINGS.subject.families


@pytest.fixture(scope="module")
def many(people: People) -> dict[str, list[Subject]]:
    return {family: [people.subject(family, seed) for seed in range(150)] for family in FAMILIES}


def test_the_same_seed_gives_the_same_person_and_another_gives_another(people: People, many: dict) -> None:
    for family, subjects in many.items():
        again = people.subject(family, 7)
        np.testing.assert_array_equal(pack(again.person), pack(subjects[7].person))
        np.testing.assert_array_equal(again.betas, subjects[7].betas)
    packed = np.stack([pack(s.person) for subjects in many.values() for s in subjects])
    assert len(np.unique(packed, axis=0)) == len(packed)
    colours = np.stack([[*s.person.skin, *s.person.cloth("top").front.first, *s.betas[:4]] for s in many["train"]])
    apart = np.linalg.norm(colours[:, None] - colours[None], axis=-1)[np.triu_indices(len(colours), 1)]
    assert apart.min() > 0.1


def test_families_have_nothing_in_common(many: dict) -> None:
    train, benchmark = FAMILIES["train"], FAMILIES["benchmark"]
    for part in ("tops", "bottoms", "footwear", "hair", "patterns", "prints"):
        assert not set(getattr(train, part)) & set(getattr(benchmark, part)), part
    assert not (set(train.jackets) & set(benchmark.jackets)) - {"none"}
    assert train.numbers[1] < benchmark.numbers[0]
    used = {}
    for family, subjects in many.items():
        worn = [c for s in subjects for c in s.person.clothes if c.worn]
        patterns = {PatternKind(p.kind) for c in worn for p in (c.front, c.back)} - {PatternKind.PLAIN}
        prints = [p for c in worn for p in (c.chest, c.spine) if p.kind != PrintKind.NOTHING]
        motifs = {p.kind for p in prints} - {PrintKind.NUMBER}
        numbers = {p.index for p in prints if p.kind == PrintKind.NUMBER}
        used[family] = (patterns, motifs, numbers)
        assert {p.name.lower() for p in patterns} == set(FAMILIES[family].patterns)
        assert {p.name.lower() for p in motifs} == set(FAMILIES[family].prints)
    for one, two in zip(used["train"], used["benchmark"], strict=True):
        assert one
        assert not one & two


def test_every_garment_of_a_family_is_worn_by_someone(many: dict) -> None:
    for family, subjects in many.items():
        for part, weights in (
            ("top", "tops"),
            ("bottom", "bottoms"),
            ("jacket", "jackets"),
            ("footwear", "footwear"),
            ("hair", "hair"),
        ):
            assert {s.outfit[part] for s in subjects} == set(getattr(FAMILIES[family], weights)), (family, part)


def test_shares_of_what_differs_between_front_and_back(many: dict) -> None:
    for subjects in many.values():
        tops = [s.person.cloth("top") for s in subjects if s.person.cloth("top").worn]
        chest = np.mean([t.chest.kind != PrintKind.NOTHING for t in tops])
        spine = np.mean([t.spine.kind != PrintKind.NOTHING for t in tops])
        panel = np.mean([t.front != t.back for t in tops])
        assert abs(chest - SETTINGS.subject.chest_print) < 0.1
        assert abs(spine - SETTINGS.subject.spine_print) < 0.1
        assert abs(panel - SETTINGS.subject.back_panel) < 0.1


def test_people_vary(people: People, many: dict) -> None:
    for subjects in many.values():
        betas = np.stack([s.betas for s in subjects])
        np.testing.assert_allclose(betas.mean(0), 0, atol=0.3)
        assert (np.abs(betas) <= SETTINGS.subject.beta_limit).all()
        assert (betas.std(0) > 0.75).all()
        skins = np.sqrt([s.person.skin for s in subjects])
        assert skins.max(0)[0] - skins.min(0)[0] > 0.5
        cloths = np.sqrt([s.person.cloth("top").front.first for s in subjects])
        assert (cloths.std(0) > 0.15).all()
    heights = [
        np.ptp(people.renderer.dress(s).rest[people.wardrobe.group_slices["body"], 2]) for s in many["train"][:40]
    ]
    assert 1.5 < min(heights) < 1.75 < 1.9 < max(heights) < 2.15


def test_unknown_names_are_named(people: People) -> None:
    with pytest.raises(ConfigError, match="family"):
        people.subject("nobody", 0)
    family = dataclasses.replace(FAMILIES["train"], tops={"cloak": 1.0})
    settings = dataclasses.replace(SETTINGS.subject, families={"train": family})
    with pytest.raises(ConfigError, match="unknown name in a family"):
        Subject.draw("train", 0, people.wardrobe.anchors, 10, settings)
