"""What distillation makes of an unseen back: colours of a mesh of true shape, of which a picture shows the front.

python benchmarks/prior_toy.py                        # the bundled prior
python benchmarks/prior_toy.py --network mine.onnx --sheet toy.png

Three people of the family `benchmark`. Vertex colours start from grey, or from magenta where the picture does not show
them; at every step four views 90 degrees apart are drawn, noised, denoised by the prior in one step, and drawn towards
the result: score distillation, 1/2 |render - x0|^2 in picture space with the target held fixed (MVDream, Shi et al.
2023). The loss of the front stays on. The rows: both starts as they are; the direct mode (pure noise) as a target;
score distillation over ranges of noise and guidance, also from the wrong start.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from soar.artifacts import write_image
from soar.losses.lpips import Lpips
from soar.metrics.colour import saturation
from soar.metrics.masked import lpips_features, mlpips, mpsnr
from soar.networks.diffusion import noised
from soar.networks.prior_inputs import VIEWS
from soar.priors.mini import BUNDLED, MiniPrior
from soar.raster import Pinhole
from soar.raster.mesh import rasterise_mesh
from soar.synthetic.records import CLOTHS, LAYERS
from soar.train import registry
from soar.train.evaluate_prior import BACK, FAMILY, SIDES
from soar.train.prior_samples import PriorSamples, Turntable, inputs
from soar.workflow import composed

PEOPLE = (1003, 1010, 1021)  # seeds
MODELS = Path("data/models")
STEPS, RATE, SETS, FRONT = 80, 0.05, 12, 1.0  # Adam steps and rate, drawn sets of four views, weight of the front
SAMPLES = 2  # per side of a pixel
MAGENTA = (1.0, -1.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Row:
    """One way to complete the back.

    Attributes:
        start: ``grey`` or ``magenta``.
        steps: of Adam; 0 shows the start.
        least, most: range of the noise; equal bounds are one level.
        guidance: see :class:`~soar.priors.mini.MiniPrior`.
    """

    start: str
    steps: int = 0
    least: float = 0.0
    most: float = 0.0
    guidance: float = 1.0


ROWS = {
    "grey": Row("grey"),
    "grey, direct": Row("grey", STEPS, 1.0, 1.0),
    "grey, t .02-.98, g 1": Row("grey", STEPS, 0.02, 0.98),
    "grey, t .02-.98, g 1.15": Row("grey", STEPS, 0.02, 0.98, 1.15),
    "grey, t .02-.98, g 1.3": Row("grey", STEPS, 0.02, 0.98, 1.3),
    "magenta": Row("magenta"),
    "magenta, t .02-.98, g 1": Row("magenta", STEPS, 0.02, 0.98),
    "magenta, t .3-.98, g 1.15": Row("magenta", STEPS, 0.3, 0.98, 1.15),
}


class Coloured:
    """A mesh in some views: which vertices, with which weights, colour every pixel.

    Args:
        vertices, faces: (V, 3) world metres, (F, 3).
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices, self.faces = torch.from_numpy(vertices).float(), torch.from_numpy(faces).long()

    def view(self, pinhole: Pinhole, T: np.ndarray) -> tuple[Tensor, Tensor]:
        """(P, S, S, 3) vertices and weights of P samples per pixel, a row of weight 0 where nothing is."""
        n = SAMPLES
        fx, fy, cx, cy = (n * value for value in (pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy))
        fine = Pinhole(fx, fy, cx, cy, n * pinhole.width, n * pinhole.height)
        pose = torch.from_numpy(T).float()
        found = rasterise_mesh(self.vertices @ pose[:3, :3].T + pose[:3, 3], self.faces, fine, "front")
        on = found.face >= 0
        corners = self.faces[found.face.long().clamp_min(0)]
        weights = found.barycentrics * on[..., None] / n**2

        def gathered(x: Tensor) -> Tensor:
            return x.reshape(pinhole.height, n, pinhole.width, n, 3).permute(1, 3, 0, 2, 4).flatten(0, 1)

        return gathered(corners), gathered(weights)


def drawn(colours: Tensor, views: list[tuple[Tensor, Tensor]]) -> Tensor:
    """(N, 3, S, S) pictures in [-1, 1] before grey, from (V, 3) colours."""
    return torch.stack([(colours[c] * w[..., None]).sum((0, 3)).permute(2, 0, 1) for c, w in views])


def mesh(samples: PriorSamples, turntable: Turntable) -> Coloured:
    """Everything that the person wears, and skin where it shows, cut along whole triangles."""
    wardrobe, posed = samples.people.wardrobe, turntable.posed
    kept, person = posed.dressed.kept, posed.dressed.subject.person
    worn = [layer for layer in LAYERS if layer == "body" or (layer in CLOTHS and person.cloth(layer).worn)]
    triangles = wardrobe.triangles(*worn)
    cut = triangles[kept[triangles].mean(1) > 0]
    return Coloured(posed.vertices, np.concatenate([cut, wardrobe.triangles("eyes")]))


class Toy:
    """One person to complete: a mesh in sets of four views, its picture, and the truth.

    Args:
        samples: where people come from.
        seed: who.
    """

    def __init__(self, samples: PriorSamples, seed: int) -> None:
        turns = [0.0, *np.random.default_rng(seed).uniform(0, 90, SETS - 1)]
        turntables = [samples.turntable(seed, FAMILY, picture=0, first=turn) for turn in turns]
        judged, coloured = turntables[0], mesh(samples, turntables[0])
        self.seed, self.vertices = seed, len(coloured.vertices)
        self.views = [[coloured.view(s.pinhole, s.T_cam_from_world) for s in each.shots] for each in turntables]
        self.alpha = [torch.stack([w.sum((0, 3)) for _, w in each])[:, None] for each in self.views]
        self.given = [inputs(each, "colour", alpha_known=True) for each in turntables]
        self.truth = torch.from_numpy(judged.pictures("colour"))
        self.mask = ((self.alpha[0] > 0.99) & (torch.from_numpy(judged.alpha) > 0.99))[:, 0].numpy().astype(np.float64)

    def complete(self, prior: MiniPrior, row: Row) -> Tensor:
        """(5, 3, S, S) four sides and the front, after completion."""
        torch.manual_seed(self.seed)
        rng = np.random.default_rng(self.seed)
        colours = torch.zeros(self.vertices, 3)
        if row.start == "magenta":
            colours += torch.tensor(MAGENTA)
        colours = self._fitted(colours).requires_grad_()
        optimiser = torch.optim.Adam([colours], lr=RATE)
        for _ in range(row.steps):
            k = int(rng.integers(SETS))
            time = float(rng.uniform(row.least, row.most))
            pictures = drawn(colours, self.views[k][:VIEWS])
            noisy = noised(pictures.detach()[None], torch.randn(1, *pictures.shape), torch.tensor([time]))[0]
            clean = torch.from_numpy(prior(noisy.numpy(), time, self.given[k], row.guidance)[0]).clamp(-1, 1)
            distil = 0.5 * ((pictures - clean).square() * self.alpha[k][:VIEWS]).sum() / VIEWS
            optimiser.zero_grad()
            (distil + FRONT * self._front_loss(colours)).backward()
            optimiser.step()
        with torch.no_grad():
            return drawn(colours, self.views[0])

    def _fitted(self, colours: Tensor) -> Tensor:
        """Colours (V, 3) with those changed that the front shows, until it looks like the picture."""
        colours = colours.clone().requires_grad_()
        optimiser = torch.optim.Adam([colours], lr=RATE)
        for _ in range(100):
            optimiser.zero_grad()
            self._front_loss(colours).backward()
            optimiser.step()
        return colours.detach()

    def _front_loss(self, colours: Tensor) -> Tensor:
        return 0.5 * (drawn(colours, self.views[0][VIEWS:])[0] - self.truth[VIEWS]).square().sum()


def figures(result: Tensor, toy: Toy, lpips: Lpips) -> dict[str, float]:
    """Masked figures of the back, the sides and the front; saturation is the mean spread of the channels."""
    shown, real = (((x + 1) / 2).clamp(0, 1).permute(0, 2, 3, 1).numpy() for x in (result, toy.truth))
    mask = toy.mask

    def distance(view: int) -> float:
        features = [lpips_features(x[view], lpips, mask[view]) for x in (shown, real)]
        return mlpips(*features, mask[view], lpips)

    return {
        "back_db": mpsnr(shown[BACK], real[BACK], mask[BACK]),
        "back_lpips": distance(BACK),
        "side_db": float(np.mean([mpsnr(shown[v], real[v], mask[v]) for v in SIDES])),
        "front_db": mpsnr(shown[VIEWS], real[VIEWS], mask[VIEWS]),
        "saturation": saturation(shown[BACK][mask[BACK] > 0]),
        "truth": saturation(real[BACK][mask[BACK] > 0]),
    }


def strip(people: list[Tensor]) -> np.ndarray:
    """(S, 4 S * people, 3) uint8: the four sides of everyone."""
    pictures = torch.cat([view for person in people for view in person[:VIEWS]], 2)
    return np.uint8(np.rint(127.5 * (pictures.clamp(-1, 1).permute(1, 2, 0).numpy() + 1)))


def main() -> None:
    """Print the table; write the sheet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--network", type=Path, default=BUNDLED)
    parser.add_argument("--sheet", type=Path, help="pictures of every row, and of the truth below")
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    samples = registry.task("prior", composed(("+train=prior",))["train"], MODELS).samples
    prior = MiniPrior(options.network, samples.settings.size, options.threads)
    lpips = Lpips.load(MODELS / "lpips_alex.safetensors", "alex")
    sheet = []
    print(f"{'':<26} back dB  LPIPS  side dB  front dB  saturation (truth)")
    toys = [Toy(samples, seed) for seed in PEOPLE]
    for name, row in ROWS.items():
        results = [toy.complete(prior, row) for toy in toys]
        found = [figures(result, toy, lpips) for result, toy in zip(results, toys, strict=True)]
        mean = {key: np.mean([person[key] for person in found]) for key in found[0]}
        sides = f"{mean['back_db']:7.2f} {mean['back_lpips']:6.3f} {mean['side_db']:8.2f} {mean['front_db']:9.2f}"
        print(f"{name:<26} {sides} {mean['saturation']:11.3f} ({mean['truth']:.3f})", flush=True)
        sheet.append(strip(results))
    sheet.append(strip([toy.truth for toy in toys]))
    if options.sheet:
        write_image(options.sheet, np.concatenate(sheet))


if __name__ == "__main__":
    main()
