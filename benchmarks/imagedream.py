"""Seconds and memory of one step with ImageDream at its full size, with random weights.

python -m benchmarks.imagedream                       # on the processor: 24 GB of memory are enough
python -m benchmarks.imagedream --device cuda --steps 50
"""

from __future__ import annotations

import argparse
import resource
import time
from types import SimpleNamespace

import torch
import yaml
from torch import nn

from benchmarks.people import ROOT
from benchmarks.timing import machine
from soar.config import settings
from soar.devices import resolve_device
from soar.priors.imagedream.checkpoint import Layout
from soar.priors.imagedream.networks import TorchNetworks
from soar.priors.imagedream.prior import FRAMES, ImageDream, ImageDreamSettings
from soar.priors.protocol import VIEWS, Condition, Views


class RandomWeights:
    """In place of a checkpoint: weights that keep signals at the size they have."""

    def load(self, prefix: str, module: nn.Module, layout: Layout, spare: object, device: torch.device,
             dtype: torch.dtype) -> None:  # fmt: skip
        """See :meth:`soar.priors.imagedream.checkpoint.Checkpoint.load`."""
        state = {}
        for key, value in module.state_dict().items():
            made = torch.zeros(value.shape, device=device, dtype=dtype)
            if value.ndim > 1:
                made.normal_(0, value[0].numel() ** -0.5)
            elif key.endswith("weight"):
                made.fill_(1.0)
            state[key] = made
        module.load_state_dict(state, assign=True)
        module.requires_grad_(False).eval()


class RandomTokens:
    """In place of the vocabulary."""

    def encode(self, text: str) -> SimpleNamespace:
        """Start, one token a word, end."""
        return SimpleNamespace(ids=[49406, *(320 + len(word) for word in text.split()), 49407])


def main() -> None:
    """Print seconds of preparing, of the first step, which reads weights, and of the others; and peak memory."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--mode", choices=FRAMES, default="pixel")
    parser.add_argument("--form", choices=("latent", "image"), default="latent")
    parser.add_argument("--steps", type=int, default=2)
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    node = yaml.safe_load((ROOT / "conf" / "prior" / "imagedream.yaml").read_text(encoding="utf-8"))
    chosen = {name: getattr(arguments, name) for name in ("device", "mode", "form")}
    options = settings(ImageDreamSettings, node | chosen, "prior")
    where = resolve_device(arguments.device, "--device")
    prior = ImageDream(options, TorchNetworks(RandomWeights(), FRAMES[options.mode], where), RandomTokens(), where)
    size = prior.size
    picture, alpha, geometry = torch.rand(3, size, size), torch.ones(1, size, size), torch.zeros(7, size, size)
    generator = torch.Generator().manual_seed(0)
    shown = torch.rand(VIEWS, 3, size, size, device=where, requires_grad=True)
    views = Views(
        shown, torch.ones(VIEWS, 1, size, size, device=where), torch.zeros(VIEWS, 7, size, size, device=where),
        torch.arange(VIEWS) * 90.0, torch.full((VIEWS,), 5.0),
    )  # fmt: skip

    def seconds(start: float) -> float:
        if where.type != "cpu":
            torch.accelerator.synchronize()
        return time.perf_counter() - start

    print(f"{options.mode}, {options.form}, {where}, {arguments.threads} threads; {machine()}")
    start = time.perf_counter()
    (prompt,) = prior.prepare([Condition("colour", picture, alpha, geometry, "a man")])
    print(f"  prepare one prompt {seconds(start):.2f} s")

    def step() -> float:
        start = time.perf_counter()
        torch.autograd.grad(prior.loss(prompt, views, 0.5, generator), shown)
        return seconds(start)

    first, *others = [step() for _ in range(arguments.steps)]
    print(f"  first step {first:.2f} s")
    if others:
        print(f"  further steps {min(others):.3f} s at least, {sorted(others)[len(others) // 2]:.3f} s in the middle")
    print(f"  peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB")
    if where.type == "cuda":
        print(f"  peak memory of the accelerator {torch.cuda.max_memory_allocated() / 1e9:.1f} GB")


if __name__ == "__main__":
    main()
