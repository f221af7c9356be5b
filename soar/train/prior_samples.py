"""Samples for the multi-view prior: a synthetic person from four sides, the picture that is known, and noise."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np

from soar.networks.prior_inputs import CONDITIONED, DOMAIN, RULES, VIEWS, assemble
from soar.priors.protocol import Domain
from soar.synthetic.render import Maps, Posed
from soar.synthetic.scene import Shot
from soar.synthetic.settings import SyntheticSettings
from soar.train.source import PeopleSource
from soar.train.task import Split

_QUIETEST = 0.02  # least time; with less noise there is nothing to learn


@dataclasses.dataclass(frozen=True)
class PriorSampleSettings:
    """What the prior learns from.

    Attributes:
        seed: of the stream of samples.
        size: side of the square pictures, pixels.
        count: samples of a batch.
        normals: share of samples whose pictures are normal maps.
        frontal: share of condition pictures that see the person within ``turned`` degrees of the front; others see them
            from anywhere.
        turned: degrees.
        elevation: (least, most) degrees above the person; one for the views, another for the picture.
        distance: (least, most) metres.
        fill: (least, most) share of the picture that the person's larger extent fills.
        misplaced: largest error of the geometry against the pictures, pixels: bodies do not fit exactly.
        alpha_known: share of samples that are told the person's alpha instead of the body's.
        dropped: share of samples whose picture is hidden, for guidance.
        blind: share of samples of pure noise, t = 1; other times are drawn with a density that grows with t.
    """

    seed: int
    size: int
    count: int
    normals: float
    frontal: float
    turned: float
    elevation: tuple[float, float]
    distance: tuple[float, float]
    fill: tuple[float, float]
    misplaced: float
    alpha_known: float
    dropped: float
    blind: float


@dataclasses.dataclass(frozen=True)
class Turntable:
    """A person from five sides: the four views and, last, the condition picture.

    Attributes:
        maps: front maps of the five.
        shots: their cameras.
        posed: the person.
        body: (5, 7, H, W) geometry of the body.
    """

    maps: tuple[Maps, ...]
    shots: tuple[Shot, ...]
    posed: Posed
    body: np.ndarray

    def pictures(self, domain: Domain) -> np.ndarray:
        """(5, 3, H, W) in [-1, 1] before grey."""
        if domain == "normal":
            return np.stack([maps.normal.numpy() * maps.alpha.numpy() for maps in self.maps])
        return np.stack([(2 * maps.colour.numpy() - 1) * maps.alpha.numpy() for maps in self.maps])

    @property
    def alpha(self) -> np.ndarray:
        """(5, 1, H, W) coverage by the clothed person."""
        return np.stack([maps.alpha.numpy()[None] for maps in self.maps])


class PriorSamples(PeopleSource):
    """A stream of samples, each a function of settings and number alone.

    Args:
        settings: see :class:`PriorSampleSettings`.
        synthetic, models: see :class:`~soar.train.source.PeopleSource`.
    """

    def __init__(self, settings: PriorSampleSettings, synthetic: SyntheticSettings, models: Path) -> None:
        super().__init__(synthetic, models)
        self.settings = settings

    def batch(self, split: Split, index: int) -> dict[str, np.ndarray]:
        """The samples of batch ``index``, stacked; see :meth:`sample`."""
        rng = np.random.default_rng([self.settings.seed, split == "validate", index])
        samples = [self.sample(child) for child in rng.spawn(self.settings.count)]
        return {name: np.stack([sample[name] for sample in samples]) for name in samples[0]}

    def sample(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """The network's inputs but for the noisy views; ``target`` (4, 3, H, W) and its ``coverage`` (4, 1, H, W);
        ``noise`` (4, 3, H, W)."""
        who, camera, chance = rng.spawn(3)
        options = self.settings
        turntable = self.turntable(
            int(who.integers(1 << 31)),
            "train",
            picture=camera.uniform(-1, 1) * (options.turned if camera.uniform() < options.frontal else 180),
            first=camera.uniform(0, 90),
            rng=camera,
        )
        domain: Domain = "normal" if chance.uniform() < options.normals else "colour"
        shown = shifted(turntable, chance, options.misplaced)
        sample = inputs(shown, domain, bool(chance.uniform() < options.alpha_known))
        sample["flags"][CONDITIONED] = chance.uniform() >= options.dropped
        blind = chance.uniform() < options.blind
        sample["time"] = np.float32(1.0 if blind else max(_QUIETEST, chance.uniform() ** 0.5))
        sample["target"], sample["coverage"] = turntable.pictures(domain)[:VIEWS], turntable.alpha[:VIEWS]
        sample["noise"] = chance.standard_normal(sample["target"].shape, np.float32)
        return mirrored(sample) if chance.uniform() < 0.5 else sample

    def turntable(
        self, seed: int, family: str, picture: float, first: float, rng: np.random.Generator | None = None
    ) -> Turntable:
        """Person ``seed`` of a family in some pose.

        Args:
            seed, family: who.
            picture: azimuth that the condition picture is taken from, degrees; 0 is the front.
            first: azimuth of the first view beyond that of the picture, degrees.
            rng: draws elevation, distance and size; without it their means are taken.
        """
        people, options = self.people, self.settings
        posed = people.posed(family, seed)

        def between(limits: tuple[float, float]) -> float:
            return float(np.mean(limits)) if rng is None else float(rng.uniform(*limits))

        distance, fill = between(options.distance), between(options.fill)
        level, elevation = between(options.elevation), between(options.elevation)
        sides = [(picture + first + 90 * view, level) for view in range(VIEWS)] + [(picture, elevation)]
        shots = tuple(people.framed(posed, *side, options.size, distance, fill) for side in sides)
        maps = tuple(people.renderer.draw(posed, shot.pinhole, shot.T_cam_from_world)[0] for shot in shots)
        body = np.stack([np.concatenate([m.place, m.body_normal, m.body_alpha[None]]) for m in maps])
        return Turntable(maps, shots, posed, body)


def inputs(turntable: Turntable, domain: Domain, alpha_known: bool) -> dict[str, np.ndarray]:
    """The network's inputs without batch axis and without ``noisy`` and ``time``, conditioned."""
    picture = turntable.pictures(domain)[VIEWS]
    return assemble(picture, turntable.body, turntable.alpha, domain == "normal", alpha_known)


def shifted(turntable: Turntable, rng: np.random.Generator, most: float) -> Turntable:
    """The geometry of each view moved against its picture by whole pixels, up to ``most``; zero where it comes from
    beyond the border."""
    room, (height, width) = math.ceil(most), turntable.body.shape[2:]
    moves = np.rint(rng.uniform(-most, most, (len(turntable.body), 2))).astype(int)
    wide = np.pad(turntable.body, [(0, 0), (0, 0), (room, room), (room, room)])
    corners = zip(wide, room - moves, strict=True)
    body = np.stack([planes[:, y : y + height, x : x + width] for planes, (y, x) in corners])
    return dataclasses.replace(turntable, body=body)


def mirrored(sample: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The sample of the mirrored person: left and right change places, in pictures, on the body, among the views."""
    out = {name: value[..., ::-1].copy() if value.ndim > 2 else value for name, value in sample.items()}
    # A view at azimuth a + 90 k becomes one at -a - 90 k: the same four sides in the other order.
    for name in ("geometry", "alpha", "carried", "target", "coverage", "noise"):
        out[name][:VIEWS] = out[name][:VIEWS][::-1]
    out["geometry"][:, (0, 3)] *= -1  # x of the place and of the normal
    if sample["flags"][DOMAIN]:
        out["image"][0] *= -1
        for name in ("target", "noise"):
            out[name][:, 0] *= -1
        out["carried"][:, : 3 * RULES : 3] *= -1
    return out
