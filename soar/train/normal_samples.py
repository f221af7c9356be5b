"""Samples for the normal network: a synthetic person, its photograph, and a mask and a body that are a little wrong."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import torch

from soar.body.lbs import pose_vertices
from soar.body.record import BodyModel
from soar.geometry.rotations import axis_angle_to_matrix
from soar.networks.normal_inputs import assemble, covered, mirrored
from soar.perception.body_normals import body_maps
from soar.synthetic.background import composed, procedural
from soar.synthetic.mannequin import Pose
from soar.synthetic.settings import SyntheticSettings
from soar.train.augment import MaskSettings, PhotoSettings, photograph, spoilt_mask
from soar.train.source import PeopleSource
from soar.train.task import Split
from soar.train.views import ViewSettings, random_shot


@dataclasses.dataclass(frozen=True)
class BodyErrorSettings:
    """How wrong the body is that the network is given, before the amount is applied.

    Attributes:
        root: largest error of the whole body's orientation about each axis, degrees.
        pose: the same of every other joint that a fit turns.
        shape: standard deviation of the error of each shape component but the first, which is the size.
        shift: largest error along each axis, metres.
        amounts: factors on all of these, of which one is drawn per sample.
        odds: probability of each.
    """

    root: float
    pose: float
    shape: float
    shift: float
    amounts: tuple[float, ...]
    odds: tuple[float, ...]


@dataclasses.dataclass(frozen=True)
class NormalSampleSettings:
    """What the network learns from.

    Attributes:
        seed: of the stream of samples.
        sizes: (height, width) of the pictures, one drawn per batch; multiples of the network's stride.
        pixels: pixels of a batch; as many pictures as fit.
        view, body, photo, mask: see there.
    """

    seed: int
    sizes: tuple[tuple[int, int], ...]
    pixels: int
    view: ViewSettings
    body: BodyErrorSettings
    photo: PhotoSettings
    mask: MaskSettings


@dataclasses.dataclass(frozen=True)
class Sample:
    """One picture with what is known of it.

    Attributes:
        rgb: (H, W, 3) uint8.
        mask: (H, W) uint8, as an estimated one.
        body_front, body_back: (H, W, 3) float32 normals of the wrong body, zero where it is not.
        front, back: (H, W, 3) float32 true clothed normals.
        alpha: (H, W) float32 true coverage.
        outfit: what is worn, as "part name".
    """

    rgb: np.ndarray
    mask: np.ndarray
    body_front: np.ndarray
    body_back: np.ndarray
    front: np.ndarray
    back: np.ndarray
    alpha: np.ndarray
    outfit: tuple[str, ...]

    @property
    def known(self) -> np.ndarray:
        """(H, W) bool: pixels that are the person's for the most part, with true normals, and not lost to the mask."""
        return covered(self.front) & covered(self.back) & (self.alpha > 0.5) & (self.mask > 0)


class NormalSamples(PeopleSource):
    """A stream of samples, each a function of settings and number alone.

    Args:
        settings: see :class:`NormalSampleSettings`.
        synthetic, models: see :class:`~soar.train.source.PeopleSource`.
    """

    def __init__(self, settings: NormalSampleSettings, synthetic: SyntheticSettings, models: Path) -> None:
        super().__init__(synthetic, models)
        self.settings = settings

    def batch(self, split: Split, index: int) -> list[dict[str, np.ndarray]]:
        """The samples of batch ``index`` as :func:`planes` gives them, all of one size."""
        rng = np.random.default_rng([self.settings.seed, split == "validate", index])
        height, width = self.settings.sizes[rng.integers(len(self.settings.sizes))]
        errors = self.settings.body
        samples = []
        for child in rng.spawn(max(1, self.settings.pixels // (height * width))):
            amount = float(child.choice(errors.amounts, p=errors.odds))
            flip = bool(child.uniform() < 0.5)
            made = planes(self.sample(child, "train", height, width, amount))
            samples.append(mirrored(made) if flip else made)
        return samples

    def sample(self, rng: np.random.Generator, family: str, height: int, width: int, amount: float) -> Sample:
        """One sample; of one ``rng`` and different amounts, all but the body's error is the same."""
        who, scene, photo, error = rng.spawn(4)
        people = self.people
        subject = people.subject(family, int(who.integers(1 << 31)))
        pose, light = people.pose(subject), people.light(subject)
        posed = people.renderer.pose(people.renderer.dress(subject), pose.pose, pose.translation, light)
        body = people.wardrobe.body
        shot = random_shot(
            scene, people.renderer.body_vertices(posed), body.up.numpy(), height, width, self.settings.view
        )
        front, back = people.renderer.draw(posed, shot.pinhole, shot.T_cam_from_world, back=True)
        assert back is not None
        image = composed(front, procedural(height, width, photo)).permute(1, 2, 0).numpy()
        alpha = front.alpha.numpy()
        wrong = wrong_body(error, body, subject.betas, pose, self.settings.body, amount)
        T = torch.from_numpy(shot.T_cam_from_world).float()
        body_front, body_back = body_maps(
            wrong @ T[:3, :3].T + T[:3, 3], body.faces[~body.interior], shot.pinhole, "auto"
        )
        return Sample(
            photograph(photo, image, self.settings.photo),
            spoilt_mask(photo, alpha, self.settings.mask),
            body_front,
            body_back,
            front.normal.permute(1, 2, 0).numpy(),
            back.normal.permute(1, 2, 0).numpy(),
            alpha,
            tuple(f"{part} {name}" for part, name in subject.outfit.items()),
        )


def planes(sample: Sample) -> dict[str, np.ndarray]:
    """Inputs and targets of a sample, (planes, H, W) float32 named as the network's inputs and outputs, and ``weight``
    (1, H, W), 1 where the truth is known."""
    out = assemble(sample.rgb, sample.mask, sample.body_front, sample.body_back)
    out["nml_F"], out["nml_B"] = sample.front.transpose(2, 0, 1), sample.back.transpose(2, 0, 1)
    out["weight"] = sample.known[None].astype(np.float32)
    return out


def wrong_body(
    rng: np.random.Generator,
    model: BodyModel,
    betas: np.ndarray,
    pose: Pose,
    settings: BodyErrorSettings,
    amount: float,
) -> torch.Tensor:
    """World vertices (V, 3) of a body whose pose, shape and place are off, as those of a fit are.

    Args:
        rng: draws the errors; the same ones whatever the amount.
        model: the body; the joints that a fit turns are turned, fingers included.
        betas: (B,) true shape.
        pose: true pose and place.
        settings: sizes of the errors.
        amount: factor on all of them; 0 gives the true body.
    """
    turn = np.zeros(pose.pose.shape, np.float32)
    turn[model.active.numpy()] = np.deg2rad(settings.pose) * rng.uniform(-1, 1, (len(model.active), 3))
    turn[0] *= settings.root / settings.pose  # joint 0 is the root of every body
    change = settings.shape * rng.standard_normal(betas.shape).astype(np.float32)
    change[0] = 0
    shift = settings.shift * rng.uniform(-1, 1, 3).astype(np.float32)
    true, error = (axis_angle_to_matrix(torch.from_numpy(angles)) for angles in (pose.pose, amount * turn))
    return pose_vertices(
        model,
        torch.from_numpy(betas + amount * change),
        true @ error,
        torch.from_numpy(pose.translation + amount * shift),
    )
