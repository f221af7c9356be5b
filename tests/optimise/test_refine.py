"""One phase of the refinement on a toy, with priors whose opinion is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Generator, Tensor

from soar.avatar.articulate import Articulation, pose
from soar.avatar.surfels import Avatar, from_body
from soar.config import settings
from soar.errors import NumericalError
from soar.geometry.rotations import axis_angle_to_matrix
from soar.networks.prior_inputs import BODY, NORMAL
from soar.optimise.checkpoint import Checkpoint
from soar.optimise.parameters import Rates, Surface
from soar.optimise.reconstruct import Observation, ReconstructSettings, reconstruct
from soar.optimise.refine import Guide, PhaseSettings, RefineWeights, refine, shots
from soar.optimise.surround import Surround, SurroundSettings
from soar.priors.protocol import VIEWS, Condition, Views
from soar.raster import Rendered, rasterise
from soar.workflow import composed
from tests.avatar import toy
from tests.conftest import conf
from tests.optimise import scene

SIZE = 32
FRAMES = 4
LEFT = torch.tensor([1.0, 0.0, 0.0])
RED = torch.tensor([1.0, 0.0, 0.0])

_NODE = composed(())["refine"]
_PHASE = settings(PhaseSettings, _NODE["texture"], "refine.texture")
TEXTURE = dataclasses.replace(
    _PHASE,
    steps=24,
    rates=dataclasses.replace(_PHASE.rates, positions=0.0, normals=0.0, colours=2e-2, scales=0.0, field=2e-2),
    weights=RefineWeights(sds=1e-3, normal_depth=0.0, curvature=0.0),
    times=((0.5, 0.98), (0.3, 0.7)),
    seen=1.0,
    reskin_every=8,
    checkpoint_seconds=0.0,
)
SHAPE = dataclasses.replace(
    TEXTURE,
    rates=dataclasses.replace(TEXTURE.rates, positions=2e-3, normals=2e-2, colours=0.0, field=0.0),
    weights=RefineWeights(sds=1e-2, normal_depth=0.05, curvature=0.1),
)
_RECONSTRUCT = settings(ReconstructSettings, conf("reconstruct", "cpu"), "reconstruct")
OBSERVED = dataclasses.replace(
    _RECONSTRUCT, weights=dataclasses.replace(_RECONSTRUCT.weights, lpips=0.0, normal_lpips=0.0)
)


class Wish:
    """A prior that wants every person in one colour, or with the body's own normals; a little noise besides.

    It keeps what it was shown, and ``at`` a call number does what it is told.
    """

    size = SIZE

    def __init__(self, at: int = -1, act: Any = None) -> None:
        self.at, self.act = at, act
        self.times: list[float] = []
        self.shown: list[Views] = []

    def prepare(self, conditions: Sequence[Condition]) -> list[Condition]:
        return list(conditions)

    def estimate(self, prompt: Condition, views: Views, time: float, generator: Generator) -> Tensor:
        alpha = views.alpha.detach()
        wanted = RED[:, None, None] * alpha
        if prompt.domain == "normal":
            normals = (views.geometry[:, NORMAL] + 1) / 2 * alpha
            wanted = torch.where(views.geometry[:, BODY] == 1, normals, views.pictures.detach())
        return wanted + 0.02 * torch.randn(views.pictures.shape, generator=generator)

    def loss(self, prompt: Condition, views: Views, time: float, generator: Generator) -> Tensor:
        self.times.append(time)
        self.shown.append(views)
        loss = 0.5 * (views.pictures - self.estimate(prompt, views, time, generator)).square().sum() / VIEWS
        return self.act(loss) if len(self.times) == self.at else loss


def grey() -> Avatar:
    """One surfel per vertex, whose rear half was never seen."""
    avatar = from_body(toy.body(), toy.motion().betas, toy.avatar_settings())
    return avatar.replace(occlusion=(avatar.rest_positions[:, 1] > 0).float())


@dataclasses.dataclass(frozen=True)
class Toy:
    """Everything a phase is given but prior and settings; the photographs show the avatar it starts with."""

    start: Avatar
    articulation: Articulation
    surround: Surround
    observed: Observation

    @staticmethod
    def of(start: Avatar) -> Toy:
        articulation, views = scene.articulation(FRAMES), scene.film(grey(), FRAMES)
        options = settings(SurroundSettings, _NODE["views"], "refine.views")
        surround = Surround(toy.body(), toy.motion(FRAMES), np.array([0.0, 0.0, 1.0]), options, SIZE)
        return Toy(start, articulation, surround, Observation([views], articulation, None, OBSERVED, toy.RASTER))

    def guide(self, prior: Wish, domain: str) -> Guide[Condition]:
        view = scene.film(grey(), FRAMES)
        conditions = [self.surround.conditions(view, i, [domain], "")[0] for i in range(FRAMES)]
        prompts = dict(zip(((0, i) for i in range(FRAMES)), prior.prepare(conditions), strict=True))
        return Guide(prior, prompts, self.surround, domain)

    def run(
        self, path: Path, prior: Wish | None, phase: PhaseSettings = TEXTURE, attributes: str = "explicit"
    ) -> tuple[Avatar, dict[str, list[float]]]:
        guide = None if prior is None else self.guide(prior, "normal" if phase.rates.normals else "colour")
        checkpoint = Checkpoint(path, "toy", phase.checkpoint_seconds)
        rest = self.observed, guide, toy.avatar_settings(attributes), phase, toy.RASTER, 0, checkpoint
        return refine("texture", self.start, self.articulation, LEFT, *rest)


@pytest.fixture(scope="module")
def person() -> Toy:
    return Toy.of(grey())


def same(a: Avatar, b: Avatar) -> bool:
    names = "positions", "quaternions", "scales", "colours", "occlusion", "rest_positions"
    return all(torch.equal(getattr(a, name), getattr(b, name)) for name in names)


# --- what a phase does ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("attributes", ["explicit", "field"])
def test_what_was_never_seen_becomes_what_the_prior_wants(person: Toy, tmp_path: Path, attributes: str) -> None:
    rates = dataclasses.replace(TEXTURE.rates, colours=4e-2, field=3e-2)
    strong = dataclasses.replace(TEXTURE, rates=rates, weights=RefineWeights(3e-3, 0.0, 0.0))
    unseen = person.start.occlusion > 0.5
    redness = {}
    for seen in (1.0, 0.02):
        avatar, curves = person.run(tmp_path / f"{seen}.pt", Wish(), dataclasses.replace(strong, seen=seen), attributes)
        assert len(curves["sds"]) == TEXTURE.steps
        assert np.mean(curves["sds"][-4:]) < 0.6 * np.mean(curves["sds"][:4])
        red = avatar.colours[:, 0] - avatar.colours[:, 1:].mean(1)
        redness[seen] = float(red[unseen].mean()), float(red[~unseen].mean())
        assert float(avatar.colours.min()) >= 0
        assert float(avatar.colours.max()) <= 1
    assert redness[1.0][0] > 0.75
    assert redness[1.0][1] > 0.5  # unmasked, the prior outvotes the photographs
    assert redness[0.02][0] > 0.65
    assert redness[0.02][1] < 0.6 * redness[1.0][1]


def test_normals_that_were_never_seen_become_the_body_s(person: Toy, tmp_path: Path) -> None:
    start = person.start
    unseen = start.occlusion > 0.5
    tilt = axis_angle_to_matrix(torch.tensor([0.5, 0.0, 0.0]))
    bent = start.replace(normals=torch.where(unseen[:, None], start.normals @ tilt.T, start.normals))
    avatar, curves = dataclasses.replace(person, start=bent).run(tmp_path / "s.pt", Wish(), SHAPE)
    assert {"sds", "views_normal_depth", "views_curvature"} < set(curves)
    assert np.mean(curves["sds"][-4:]) < 0.8 * np.mean(curves["sds"][:4])
    before, after = ((a.normals * start.normals).sum(1)[unseen].mean() for a in (bent, avatar))
    assert after > before + 0.5 * (1 - before)
    assert torch.equal(avatar.colours, start.colours)
    assert 0 < (avatar.positions - start.positions).abs().max() < 0.1


@pytest.mark.parametrize("attributes", ["explicit", "field"])
def test_a_step_goes_against_the_gradient_in_every_entry(attributes: str) -> None:
    """The fused optimiser walks through memory as it lies: a parameter that is a view of another would be scrambled."""
    rates = Rates(positions=1e-3, normals=1e-3, colours=1e-3, scales=1e-3, field=1e-3)
    surface = Surface(grey(), toy.avatar_settings(attributes), torch.Generator().manual_seed(0))
    before = {name: parameter.detach().clone() for name, parameter in surface.named_parameters()}
    generator = torch.Generator().manual_seed(1)
    for parameter in surface.parameters():
        parameter.grad = torch.randn(parameter.shape, generator=generator)
    for optimiser in surface.optimisers(rates, shared=False):
        optimiser.step()
    for name, parameter in surface.named_parameters():
        assert parameter.grad is not None
        expected = before[name] - 1e-3 * parameter.grad.sign()
        torch.testing.assert_close(parameter.detach(), expected, atol=1e-6, rtol=0, msg=name)


@pytest.mark.parametrize("attributes", ["explicit", "field"])
def test_rate_0_holds_still(person: Toy, tmp_path: Path, attributes: str) -> None:
    avatar, _ = person.run(tmp_path / "s.pt", Wish(), dataclasses.replace(TEXTURE, steps=5), attributes)
    start = person.start
    assert torch.equal(avatar.positions, start.positions)
    assert torch.equal(avatar.occlusion, start.occlusion)
    # The quaternion is made anew from the normal, which costs it the last bits.
    torch.testing.assert_close(avatar.normals, start.normals, atol=1e-6, rtol=0)
    if attributes == "explicit":
        torch.testing.assert_close(avatar.scales, start.scales, atol=0, rtol=1e-6)  # through a logarithm
    assert (avatar.colours - start.colours).abs().max() > 0.01


def test_positions_may_move_alone(person: Toy, tmp_path: Path) -> None:
    rates = dataclasses.replace(SHAPE.rates, normals=0.0)
    avatar, _ = person.run(tmp_path / "s.pt", None, dataclasses.replace(SHAPE, steps=2, rates=rates))
    assert not torch.equal(avatar.positions, person.start.positions)
    torch.testing.assert_close(avatar.normals, person.start.normals, atol=1e-6, rtol=0)


@pytest.mark.parametrize("attributes", ["explicit", "field"])
def test_a_phase_of_no_steps_gives_the_avatar_back(tmp_path: Path, attributes: str) -> None:
    """Places and colours bit by bit; normals and radii but for the last bits of the way through their parameters.

    Colours that come from the field are held 0.001 off black and full: there its logits end.
    """
    start = grey().replace(colours=torch.rand(len(grey()), 3, generator=torch.Generator().manual_seed(0)) * 1.2 - 0.1)
    start = start.replace(colours=start.colours.clamp(0, 1))
    avatar, curves = Toy.of(start).run(tmp_path / "s.pt", Wish(), dataclasses.replace(TEXTURE, steps=0), attributes)
    assert curves == {}
    assert torch.equal(avatar.positions, start.positions)
    assert torch.equal(avatar.occlusion, start.occlusion)
    torch.testing.assert_close(avatar.normals, start.normals, atol=1e-6, rtol=0)
    torch.testing.assert_close(avatar.scales, start.scales, atol=0, rtol=2e-6)
    if attributes == "explicit":
        assert torch.equal(avatar.colours, start.colours)
    else:
        torch.testing.assert_close(avatar.colours, start.colours.clamp(1e-3, 1 - 1e-3), atol=1e-6, rtol=0)


def test_without_a_guide_it_is_the_reconstruction(person: Toy, tmp_path: Path) -> None:
    phase = dataclasses.replace(SHAPE, steps=12, rates=dataclasses.replace(SHAPE.rates, colours=1e-2, scales=1e-2))
    avatar, curves = person.run(tmp_path / "refine.pt", None, phase)
    shared = {f.name: getattr(phase, f.name) for f in dataclasses.fields(type(phase).__mro__[1])}
    options = dataclasses.replace(OBSERVED, **shared)
    body = person.start, person.articulation, LEFT, [scene.film(grey(), FRAMES)], None
    checkpoint = Checkpoint(tmp_path / "reconstruct.pt", "toy", 0.0)
    expected, terms = reconstruct(*body, toy.avatar_settings(), options, toy.RASTER, 0, checkpoint)
    assert curves == terms
    assert not {"sds", "views_normal_depth", "views_curvature"} & set(curves)
    assert same(avatar, expected)
    assert not torch.equal(avatar.positions, person.start.positions)


def test_times_lie_between_limits_that_move_evenly(person: Toy, tmp_path: Path) -> None:
    prior = Wish()
    phase = dataclasses.replace(TEXTURE, steps=40, times=((0.6, 1.0), (0.1, 0.3)))
    person.run(tmp_path / "s.pt", prior, phase)
    at = np.linspace(0, 1, 40)
    low, high = 0.6 + (0.1 - 0.6) * at, 1.0 + (0.3 - 1.0) * at
    share = (np.array(prior.times) - low) / (high - low)
    assert share.min() > -1e-6
    assert share.max() < 1 + 1e-6
    counts, _ = np.histogram(share, 4, (0, 1))
    assert counts.min() >= 4  # of 10 expected in each quarter
    assert abs(np.corrcoef(share, at)[0, 1]) < 0.4

    pure = Wish()
    person.run(tmp_path / "t.pt", pure, dataclasses.replace(TEXTURE, steps=3, times=((1.0, 1.0), (1.0, 1.0))))
    assert pure.times == [1.0, 1.0, 1.0]


def test_the_prior_is_shown_four_sides_in_the_crop_s_pose(person: Toy, tmp_path: Path) -> None:
    prior = Wish()
    person.run(tmp_path / "s.pt", prior, dataclasses.replace(TEXTURE, steps=8))
    for views in prior.shown:
        assert views.pictures.shape == (VIEWS, 3, SIZE, SIZE)
        assert views.alpha.shape == (VIEWS, 1, SIZE, SIZE)
        assert views.geometry.shape == (VIEWS, 7, SIZE, SIZE)
        torch.testing.assert_close(views.azimuth.diff(), torch.full((3,), 90.0))
        assert 0 <= views.azimuth[0] <= 90
        assert (views.elevation == views.elevation[0]).all()
        assert (views.pictures <= views.alpha + 1e-4).all()  # multiplied by alpha
        body, avatar = views.geometry[:, BODY] > 0.5, views.alpha > 0.5
        assert (body & avatar).sum() / body.sum() > 0.97
        assert not views.geometry.requires_grad
    assert len({float(views.azimuth[0]) for views in prior.shown}) == 8  # drawn anew each step


# --- masking ----------------------------------------------------------------------------------------------------------


def looks_and_renders(person: Toy, colours: Tensor, occlusion: Tensor) -> tuple[list, list[Rendered]]:
    """The start in frame 0 from four sides."""
    start = person.start
    looks = person.surround.looks(0, toy.camera(), torch.full((4,), 0.3))
    blend = person.articulation.blend(start.positions, start.neighbours)
    positions, normals = pose(start.positions, start.normals, blend, person.articulation.transforms[0])
    renders = []
    for look in looks:
        R, t = look.T_cam_from_world[:3, :3], look.T_cam_from_world[:3, 3]
        surfels = positions @ R.T + t, normals @ R.T, start.scales, colours, occlusion
        renders.append(rasterise(*surfels, person.surround.fine(look), side="front", settings=toy.RASTER))
    return looks, renders


def test_seen_scales_the_gradient_of_surfels(person: Toy) -> None:
    guide, generator = person.guide(Wish(), "colour"), torch.Generator().manual_seed(1)
    upstream = torch.rand(VIEWS, 3, SIZE, SIZE, generator=generator)
    for tau, expected in ((0.0, 0.05), (0.5, 0.05**0.5), (1.0, 1.0)):
        pictures, gradients = [], []
        for seen in (1.0, 0.05):
            colours = person.start.colours.clone().requires_grad_()
            occlusion = torch.full_like(person.start.occlusion, tau)
            looks, renders = looks_and_renders(person, colours, occlusion)
            views = shots(renders, looks, guide, 0, seen)
            (gradient,) = torch.autograd.grad((views.pictures * upstream).sum(), colours)
            pictures.append(views.pictures.detach())
            gradients.append(gradient)
        torch.testing.assert_close(pictures[0], pictures[1], atol=1e-7, rtol=0)  # what is shown is not masked
        assert gradients[0].abs().sum() > 1
        # Where a surfel's footprint ends alpha vanishes, and tau with it.
        torch.testing.assert_close(gradients[1], expected * gradients[0], atol=2e-4, rtol=2e-3)


def fake_renders(person: Toy, domain: str) -> tuple[Guide, list, list[Tensor], Tensor]:
    """Four looks, leaf planes whose pixels differ in alpha and tau, and tau of the prior's pixels."""
    generator = torch.Generator().manual_seed(2)
    guide, samples = person.guide(Wish(), domain), person.surround.settings.samples
    looks = person.surround.looks(0, toy.camera(), torch.full((4,), 0.3))
    alpha = 0.2 + 0.8 * torch.rand(VIEWS, 1, SIZE, SIZE, generator=generator)
    tau = torch.rand(VIEWS, 1, SIZE, SIZE, generator=generator)
    tau[:, :, :8], tau[:, :, 8:16] = 0, 1
    planes = torch.cat([torch.rand(VIEWS, 7, SIZE, SIZE, generator=generator), alpha, alpha * tau], 1)
    fine = planes.repeat_interleave(samples, 2).repeat_interleave(samples, 3)
    return guide, looks, [plane.clone().requires_grad_() for plane in fine], tau


def weights_of(person: Toy, domain: str, seen: float) -> tuple[Tensor, Tensor]:
    """What a pixel's gradient was multiplied by, (4, 3, S, S) of pictures, and tau (4, 1, S, S)."""
    guide, looks, leaves, tau = fake_renders(person, domain)
    views = shots([Rendered(leaf) for leaf in leaves], looks, guide, 0, seen)
    gradients = torch.autograd.grad(views.pictures.sum(), leaves)
    samples = person.surround.settings.samples
    at = slice(0, 3) if domain == "colour" else slice(3, 6)
    pooled = torch.nn.functional.avg_pool2d(torch.stack(gradients)[:, at], samples) * samples**2
    assert (torch.stack(gradients)[:, 8] == 0).all()  # tau is not moved
    return pooled if domain == "colour" else 2 * pooled, tau


@pytest.mark.parametrize("domain", ["colour", "normal"])
@pytest.mark.parametrize("seen", [1.0, 0.3, 0.05])
def test_a_pixel_s_share_is_seen_to_the_power_of_1_minus_tau(person: Toy, domain: str, seen: float) -> None:
    share, tau = weights_of(person, domain, seen)
    torch.testing.assert_close(share, (seen ** (1 - tau)).expand_as(share), atol=1e-5, rtol=1e-5)


def test_seen_0_leaves_the_prior_only_what_was_never_seen(person: Toy) -> None:
    share, tau = weights_of(person, "colour", 0.0)
    assert (share[(tau < 0.99).expand_as(share)] == 0).all()
    assert share[:, :, 8:16].median() == pytest.approx(1, abs=1e-5)


def test_normals_are_shown_as_colours(person: Toy) -> None:
    guide, looks, leaves, _ = fake_renders(person, "normal")
    views = shots([Rendered(leaf) for leaf in leaves], looks, guide, 0, 1.0)
    samples = person.surround.settings.samples
    planes = torch.stack(leaves)[:, :, ::samples, ::samples]
    torch.testing.assert_close(views.pictures, (planes[:, 3:6] + planes[:, 7:8]) / 2)
    torch.testing.assert_close(views.alpha, planes[:, 7:8])


# --- the same bits, and failures --------------------------------------------------------------------------------------


def interrupt(_: Tensor) -> Tensor:
    raise KeyboardInterrupt


@pytest.mark.parametrize(("phase", "attributes"), [(TEXTURE, "field"), (SHAPE, "explicit")], ids=["texture", "shape"])
def test_runs_repeat_and_go_on_where_they_were_killed(
    person: Toy, tmp_path: Path, phase: PhaseSettings, attributes: str
) -> None:
    phase = dataclasses.replace(phase, steps=16, reskin_every=4, seen=0.05)
    whole, curves = person.run(tmp_path / "whole.pt", Wish(), phase, attributes)
    with pytest.raises(KeyboardInterrupt):
        person.run(tmp_path / "killed.pt", Wish(15, interrupt), phase, attributes)
    prior = Wish()
    again, continued = person.run(tmp_path / "killed.pt", prior, phase, attributes)
    assert len(prior.times) == 2  # the state of step 14 was saved
    assert same(whole, again)
    assert continued == curves
    # What is finished is not done again.
    prior = Wish()
    finished, kept = person.run(tmp_path / "killed.pt", prior, phase, attributes)
    assert not prior.times
    assert same(whole, finished)
    assert kept == curves
    repeated, values = person.run(tmp_path / "repeated.pt", Wish(), phase, attributes)
    assert same(whole, repeated)
    assert values == curves


def test_another_seed_is_another_run(person: Toy, tmp_path: Path) -> None:
    short = dataclasses.replace(TEXTURE, steps=3)
    first, second = Wish(), Wish()
    person.run(tmp_path / "a.pt", first, short)
    rest = person.observed, person.guide(second, "colour"), toy.avatar_settings(), short, toy.RASTER, 1
    refine("texture", person.start, person.articulation, LEFT, *rest, Checkpoint(tmp_path / "b.pt", "toy", 0.0))
    assert first.times != second.times


def refuse(_: Tensor) -> Tensor:
    raise NumericalError("the prior gave NaN or infinity")


@pytest.mark.parametrize(
    ("act", "says"),
    [(lambda loss: loss * float("nan"), "texture stopped at step 5: loss term sds is not finite"), (refuse, "NaN")],
    ids=["loss", "error"],
)
def test_a_prior_without_numbers_is_named_and_the_state_before_it_kept(
    person: Toy, tmp_path: Path, act: Any, says: str
) -> None:
    before = dataclasses.replace(
        person.start, **{n: v.clone() for n, v in vars(person.start).items() if n != "neighbours"}
    )
    with pytest.raises(NumericalError, match=says):
        person.run(tmp_path / "s.pt", Wish(6, act))
    assert same(before, person.start)
    state = Checkpoint(tmp_path / "s.pt", "toy", 0.0).load()
    assert state is not None
    assert state["step"] == 5
    assert all(torch.isfinite(value).all() for value in state["surface"].values())


@pytest.mark.parametrize("preset", ["cpu", "paper"])
@pytest.mark.parametrize("phase", ["shape", "texture"])
def test_every_phase_saves_its_state_on_the_way(preset: str, phase: str) -> None:
    """A state is saved where skinning weights are renewed, at the earliest."""
    node = composed((f"preset={preset}",))["refine"][phase]
    options = settings(PhaseSettings, node, f"refine.{phase}")
    assert options.reskin_every <= options.steps / 2
