"""One reconstruction step, part by part, each beside the plain way of doing it.

python -m benchmarks.reconstruct --threads 2
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path

import torch
import yaml
from torch import Tensor

from benchmarks.scenes import figure
from benchmarks.timing import interleaved, machine
from soar.avatar.articulate import pose, unit
from soar.avatar.field import Field
from soar.avatar.settings import AvatarSettings
from soar.avatar.surfels import nearest
from soar.config import settings
from soar.losses.lpips import Lpips
from soar.losses.normal import cosine
from soar.losses.photometric import SsimTarget, _kernel, blur, l1, ssim
from soar.losses.regularise import normal_depth, offset_laplacian
from soar.optimise.sobolev import Sobolev
from soar.raster import Pinhole, RasterSettings, rasterise_both

ROOT = Path(__file__).resolve().parent.parent
RASTER = RasterSettings(lowpass_px2=1 / 12, compensate=True, cull=True, backend="auto")


def main() -> None:
    """Print milliseconds (least / median), forward and backward together, and ratios to the plain way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--surfels", type=int, default=50_000)
    parser.add_argument("--height", type=int, default=448, help="of the window, pixels")
    parser.add_argument("--width", type=int, default=240, help="of the window, pixels")
    parser.add_argument("--bones", type=int, default=49, help="groups of bones that move")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=10)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    jobs = parts(arguments.surfels, arguments.height, arguments.width, arguments.bones)
    times = interleaved(jobs, dict.fromkeys(jobs, arguments.rounds))
    size = f"{arguments.surfels} surfels, {arguments.height} x {arguments.width} px"
    print(f"{size}, {arguments.threads} threads, {machine()}")
    for name, (least, median) in times.items():
        plain = times.get(f"{name}, plain")
        print(f"{name:32s} {least:8.1f} / {median:8.1f} ms" + (f"   x {plain[0] / least:.1f}" if plain else ""))


def parts(count: int, height: int, width: int, bones: int) -> dict[str, Callable[[], None]]:
    """The jobs; a job called ``X, plain`` is what X is compared with."""
    generator = torch.Generator().manual_seed(0)
    positions, normals, scales, colours, occlusion = figure(count)
    pinhole = Pinhole(2.2 * height, 2.2 * height, width / 2, height / 2, width, height)
    surfels = [t.requires_grad_() for t in (positions, normals, scales, colours)]
    front, back = (r.planes.detach() for r in rasterise_both(*surfels, occlusion, pinhole, settings=RASTER))
    planes = front.clone().requires_grad_()
    image, normal, depth, alpha = planes[:3], planes[3:6], planes[6], planes[7]
    photograph = torch.rand(3, height, width, generator=generator)
    mask = (alpha.detach() > 0.5).float()
    blend = torch.rand(count, bones, generator=generator)
    transforms = torch.eye(4)[:3].repeat(bones, 1, 1) / blend.sum(1).mean()
    ring = nearest(positions, positions, 7)[1]
    spread = Sobolev.of(positions.detach(), ring, 4, torch.tensor([1.0, 0.0, 0.0]), 1.0)

    def learn(loss: Callable[[], Tensor]) -> Callable[[], None]:
        return lambda: loss().backward()

    def field(**changes: object) -> Callable[[], Tensor]:
        node = yaml.safe_load((ROOT / "conf/avatar/default.yaml").read_text())
        size = dataclasses.replace(settings(AvatarSettings, node).field, **changes)
        phi = Field(positions.detach(), colours.detach(), scales.detach(), size, torch.Generator().manual_seed(0))
        return lambda: sum(x.sum() for x in phi(positions.detach()))

    def convolved() -> Tensor:
        """SSIM's backward through a depthwise convolution of the same fifteen channels."""
        k = torch.as_tensor(_kernel(), dtype=torch.float32)
        stack = torch.cat([image, photograph, image * image, photograph * photograph, image * photograph])[:, None]
        across = torch.nn.functional.conv2d(stack, k.view(1, 1, 1, -1), padding=(0, 5))
        return torch.nn.functional.conv2d(across, k.view(1, 1, -1, 1), padding=(5, 0)).sum()

    target = SsimTarget.of(photograph)
    jobs = {
        "pose": learn(lambda: sum(x.sum() for x in pose(positions, unit(normals), blend, transforms))),
        "raster front and back": learn(
            lambda: sum(r.planes.sum() for r in rasterise_both(*surfels, occlusion, pinhole, settings=RASTER))
        ),
        "field": learn(field()),
        "field, plain": learn(field(chunk=10**9)),
        "L1": learn(lambda: l1(image, photograph)),
        "SSIM": learn(lambda: ssim(image, target)),
        "SSIM, plain": learn(convolved),
        "SSIM target moments": lambda: SsimTarget.of(photograph),
        "blur of 9 planes": lambda: blur(torch.cat([front[:9]])),
        "normals": learn(lambda: cosine(normal, back[3:6], mask)),
        "normals against depth": learn(lambda: normal_depth(normal, depth, alpha, pinhole)),
        "Laplacian of the offset": learn(lambda: offset_laplacian(positions, positions.detach() * 0.99, ring[:, 1:])),
        "smoothing of the gradient": lambda: spread(positions.detach()),
    }
    weights = ROOT / "data/models/lpips_alex.safetensors"
    if weights.exists():
        lpips = Lpips.load(weights, "alex")
        features = lpips.features(photograph[None])
        jobs["LPIPS"] = learn(lambda: lpips.distance(lpips.features(image[None]), features).sum())
        jobs["LPIPS, plain"] = learn(lambda: lpips(image[None], photograph[None]).sum())
    return jobs


if __name__ == "__main__":
    main()
