"""What the prior knows of the unseen side, beside what colour transfer by hand knows, on people it never met."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from soar.body.parts import bones_of_vertices
from soar.body.record import BodyModel
from soar.losses.lpips import Lpips
from soar.metrics.masked import lpips_features, mlpips, mpsnr
from soar.networks.diffusion import noised, sample
from soar.networks.normal_inputs import fill, nearest_known
from soar.networks.prior_inputs import BODY, CANONICAL_CENTRE, PLACE, SEEN, VIEWS, carried
from soar.priors.mini import MiniPrior
from soar.synthetic.records import LAYERS, PrintKind
from soar.synthetic.subject import Subject
from soar.train.prior_samples import PriorSamples, Turntable, inputs

FAMILY = "benchmark"

BACK, SIDES = 2, (1, 3)
"""Views of a turntable that starts at the front."""

_HAIR = [LAYERS.index(name) for name in ("hair", "long_hair", "cap", "brim")]


@dataclasses.dataclass(frozen=True)
class PriorEvaluationSettings:
    """What is measured.

    Attributes:
        seed: of the first person; the others follow.
        count: people.
        times: noise levels at which the truth is shown, noised, for one step.
        guidance: scales that are sampled with.
        steps: of a sampling.
    """

    seed: int
    count: int
    times: tuple[float, ...]
    guidance: tuple[float, ...]
    steps: int


@dataclasses.dataclass(frozen=True)
class Parts:
    """Body parts by canonical place, left and right apart.

    Attributes:
        places: (V, 3) of the vertices.
        labels: (V,) number of the part; 0 is the head.
    """

    places: np.ndarray
    labels: np.ndarray

    @classmethod
    def of(cls, body: BodyModel) -> Parts:
        """The parts are the large bones, see :func:`soar.body.parts.bones_of_vertices`."""
        known = {"head": 0}
        labels = [known.setdefault(bone, len(known)) for bone in bones_of_vertices(body)]
        return cls(body.v_template.numpy() - np.float32(CANONICAL_CENTRE), np.array(labels))

    @functools.cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.places)

    def map(self, geometry: np.ndarray) -> np.ndarray:
        """(H, W) number of the part that each pixel of a (7, H, W) geometry shows, -1 where no body is."""
        out = np.full(geometry.shape[1:], -1)
        on = geometry[BODY][0] > SEEN
        out[on] = self.labels[self._tree.query(geometry[PLACE][:, on].T)[1]]
        return out


def evaluate(
    prior: MiniPrior, samples: PriorSamples, parts: Parts, lpips: Lpips, settings: PriorEvaluationSettings
) -> dict[str, Any]:
    """Masked PSNR (dB) and LPIPS of every method, from one picture of the front; people count alike.

    Returns:
        ``methods``: ``{method: {figure: (people,) values}}`` with the figures ``back_db``, ``back_lpips``, ``side_db``,
        ``side_lpips``, and ``head_db`` on head, hair and hat from behind, NaN where there is nothing; and ``plain``:
        (people,) whether their clothes have no print and a back like their front.
    """
    compared = methods(prior, parts, settings)
    people: list[dict[str, dict[str, float]]] = []
    plainly: list[bool] = []
    for index in range(settings.count):
        turntable = samples.turntable(settings.seed + index, FAMILY, picture=0, first=0)
        rng = np.random.default_rng([settings.seed, index])
        noise = rng.standard_normal((VIEWS, 3, prior.size, prior.size), np.float32)
        truth = Truth(turntable, parts, lpips)
        people.append({name: truth.figures(method(turntable, noise)) for name, method in compared.items()})
        plainly.append(plain(turntable.posed.dressed.subject))
    rows = {
        method: {name: [person[method][name] for person in people] for name in values}
        for method, values in people[0].items()
    }
    return {"methods": rows, "plain": plainly}


Method = Callable[[Turntable, np.ndarray], np.ndarray]


def methods(prior: MiniPrior, parts: Parts, settings: PriorEvaluationSettings) -> dict[str, Method]:
    """Functions of a turntable and noise (4, 3, S, S) that give pictures (4, 3, S, S) in [-1, 1].

    All know the person's alpha: the prior is told, and colour transfer by hand fills it and is laid over grey by it.
    """

    def carry(turntable: Turntable, rule: int) -> np.ndarray:
        body, pictures = turntable.body, turntable.pictures("colour")
        # Reaches every pixel, unlike what the prior is given.
        colours = carried(pictures[VIEWS], turntable.alpha[VIEWS, 0], body[VIEWS], body[:VIEWS], prior.size)
        return colours[:, 3 * rule : 3 * rule + 3] * turntable.alpha[:VIEWS]

    def step(turntable: Turntable, noise: np.ndarray, time: float, guidance: float) -> np.ndarray:
        given = inputs(turntable, "colour", alpha_known=True)
        truth = torch.from_numpy(turntable.pictures("colour")[:VIEWS])[None]
        noisy = noised(truth, torch.from_numpy(noise)[None], torch.tensor([time]))[0].numpy()
        return prior(noisy, time, given, guidance)[0]

    def sampled(turntable: Turntable, noise: np.ndarray, guidance: float) -> np.ndarray:
        given = inputs(turntable, "colour", alpha_known=True)

        def clean(noisy: torch.Tensor, time: torch.Tensor) -> torch.Tensor:
            return torch.from_numpy(prior(noisy[0].numpy(), float(time), given, guidance)[0])[None]

        return sample(clean, torch.from_numpy(noise)[None], settings.steps)[0].numpy()

    out: dict[str, Method] = {
        "part mean": lambda turntable, noise: part_means(turntable, parts) * turntable.alpha[:VIEWS],
        "mirrored": lambda turntable, noise: carry(turntable, 0),
        "nearest": lambda turntable, noise: carry(turntable, 1),
        "direct": lambda turntable, noise: step(turntable, noise, 1.0, 1.0),
    }
    for time in settings.times:
        out[f"one step, t = {time:g}"] = lambda turntable, noise, t=time: step(turntable, noise, t, 1.0)
        out[f"unconditional, t = {time:g}"] = lambda turntable, noise, t=time: step(turntable, noise, t, 0.0)
    for scale in settings.guidance:
        out[f"sampled, g = {scale:g}"] = lambda turntable, noise, g=scale: sampled(turntable, noise, g)
    return out


def part_means(turntable: Turntable, parts: Parts) -> np.ndarray:
    """(4, 3, S, S): every part of the body in the mean colour that the condition picture shows of it.

    Parts that it does not show get the mean of the whole person.
    """
    picture, seen = turntable.pictures("colour")[VIEWS], turntable.alpha[VIEWS, 0] > SEEN
    label = parts.map(turntable.body[VIEWS])
    means = np.tile(picture[:, seen & (label >= 0)].mean(1), (parts.labels.max() + 1, 1))
    for part in np.unique(label[seen & (label >= 0)]):
        means[part] = picture[:, seen & (label == part)].mean(1)
    out = []
    for geometry in turntable.body[:VIEWS]:
        shown = parts.map(geometry)
        on = shown >= 0
        colours = means[np.maximum(shown, 0)] * on[..., None]
        out.append(fill(colours, nearest_known(on, np.ones_like(on))).transpose(2, 0, 1))
    return np.stack(out)


class Truth:
    """One person's true views, and what judging pictures of them needs of those, computed once."""

    def __init__(self, turntable: Turntable, parts: Parts, lpips: Lpips) -> None:
        self.lpips, self.mask = lpips, turntable.alpha[:VIEWS, 0]
        self.pictures = _shown(turntable.pictures("colour")[:VIEWS])
        self.features = {v: lpips_features(self.pictures[v], lpips, self.mask[v]) for v in (BACK, *SIDES)}
        layer = turntable.maps[BACK].layer.numpy()
        head = np.isin(layer, _HAIR) | ((layer == 0) & (parts.map(turntable.body[BACK]) == 0))
        self.head = head * self.mask[BACK]

    def figures(self, images: np.ndarray) -> dict[str, float]:
        """Figures of pictures (4, 3, S, S) in [-1, 1]; see :func:`evaluate`."""
        shown = _shown(images)
        back, sides = self._both(shown, BACK), np.mean([self._both(shown, view) for view in SIDES], 0)
        return {
            "back_db": back[0],
            "back_lpips": back[1],
            "side_db": float(sides[0]),
            "side_lpips": float(sides[1]),
            "head_db": mpsnr(shown[BACK], self.pictures[BACK], self.head),
        }

    def _both(self, shown: np.ndarray, view: int) -> tuple[float, float]:
        features = lpips_features(shown[view], self.lpips, self.mask[view])
        distance = mlpips(features, self.features[view], self.mask[view], self.lpips)
        return mpsnr(shown[view], self.pictures[view], self.mask[view]), distance


def _shown(images: np.ndarray) -> np.ndarray:
    """(V, 3, S, S) in [-1, 1] to (V, S, S, 3) in [0, 1]."""
    return np.clip((images.transpose(0, 2, 3, 1) + 1) / 2, 0, 1)


def plain(subject: Subject) -> bool:
    """Whether nothing is printed on the clothes and their back is like their front, so that no jacket is open."""
    worn = [cloth for cloth in subject.person.clothes if cloth.worn]
    prints = [side.kind for cloth in worn for side in (cloth.chest, cloth.spine)]
    alike = all(cloth.front == cloth.back and not cloth.opening for cloth in worn)
    return alike and all(kind == PrintKind.NOTHING for kind in prints)


def table(result: Mapping[str, Any]) -> str:
    """The means as aligned text: everyone, those with plain clothes, heads from behind."""
    chosen = np.array(result["plain"])
    lines = [
        f"{len(chosen)} people, {chosen.sum()} in plain clothes; masked PSNR, dB, and masked LPIPS (AlexNet)",
        f"{'':<26} {'back':>13} {'side':>13} {'back, plain':>13}  head from behind",
    ]
    for method, rows in result["methods"].items():
        values = {name: np.array(row) for name, row in rows.items()}
        cells = [
            f"{_mean(values[f'{view}_db'][among]):>7.2f} {_mean(values[f'{view}_lpips'][among]):.3f}"
            for view, among in (("back", slice(None)), ("side", slice(None)), ("back", chosen))
        ]
        lines.append(f"{method:<26} {' '.join(cells)}  {_mean(values['head_db']):>7.2f}")
    return "\n".join(lines)


def _mean(values: np.ndarray) -> float:
    """Of those that are not NaN; NaN if none is."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else float("nan")
