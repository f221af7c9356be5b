"""The loop that reconstruction and refinement share: its rates, its failures, and going on where it was killed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
import torch
from torch import Tensor

from soar.avatar.articulate import pose
from soar.avatar.surfels import Avatar, from_body
from soar.errors import ConfigError, NumericalError
from soar.optimise.checkpoint import Checkpoint
from soar.optimise.descent import DescentSettings, Terms, descend
from soar.optimise.parameters import Rates, Surface
from soar.optimise.sobolev import Sobolev
from tests.avatar import toy
from tests.optimise import scene

LEFT = torch.tensor([1.0, 0.0, 0.0])
ARTICULATION = scene.articulation()
RATES = Rates(positions=1e-3, normals=2e-3, colours=4e-3, scales=8e-3, field=0.0)
RATE_OF = {"positions": "positions", "normals": "normals", "colours": "colours", "log_scales": "scales"}
SETTINGS = DescentSettings(
    steps=12,
    rates=RATES,
    final_rate=0.1,
    laplacian_neighbours=4,
    smoothing=1,
    symmetry=0.5,
    reskin_every=4,
    checkpoint_seconds=0.0,
)
NEVER_DUE = dataclasses.replace(SETTINGS, checkpoint_seconds=1e6)

Look = Callable[[Surface, int, Tensor, Tensor], Terms]


def start() -> Avatar:
    """One surfel per vertex, pushed off its place at rest, so that the two cannot be taken for each other."""
    avatar = from_body(toy.body(), toy.motion().betas, toy.avatar_settings())
    push = torch.randn(avatar.positions.shape, generator=torch.Generator().manual_seed(0))
    return avatar.replace(positions=avatar.positions + 0.02 * push)


START = start()


@pytest.fixture(scope="module", autouse=True)
def _first_optimiser() -> None:
    """Making a process's first optimiser imports torch's compiler, for seconds: not at the first test's expense."""
    torch.optim.Adam([torch.zeros(1, requires_grad=True)])


def fresh() -> Surface:
    return Surface(START, toy.avatar_settings(), torch.Generator().manual_seed(0))


def run(made: Surface, look: Look, path: Path, settings: DescentSettings = SETTINGS) -> dict[str, list[float]]:
    checkpoint = Checkpoint(path, "toy", settings.checkpoint_seconds)
    return descend("toy", made, ARTICULATION, LEFT, settings, checkpoint, lambda *given: look(made, *given))


def values(made: Surface) -> dict[str, Tensor]:
    return {name: parameter.detach().clone() for name, parameter in made.named_parameters()}


def same(a: Mapping[str, Tensor], b: Mapping[str, Tensor]) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)


def pull(made: Surface, step: int, blend: Tensor, ring: Tensor) -> Terms:
    """Every parameter somewhere, by way of the skinning weights and the neighbours; ``size`` only at odd steps."""
    moved, turned = pose(made.positions, made.normals, blend, ARTICULATION.transforms[step % 4])
    terms = {
        "place": (1.0, (moved - START.rest_positions).square().sum()),
        "turn": (0.1, (turned[ring[:, 1]] - turned).square().sum()),
        "colour": (2.0, (made.colours - 0.1 * (step % 5)).square().sum()),
    }
    return terms | ({"size": (0.5, (made.log_scales + 4).square().sum())} if step % 2 else {})


# --- rates ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("smoothing", [0, 1])
def test_rates_fall_along_half_a_cosine(tmp_path: Path, smoothing: int) -> None:
    """A gradient that never changes moves Adam by the rate itself, whichever of the two Adams it is."""
    seen: list[dict[str, Tensor]] = []

    def slope(made: Surface, *_: object) -> Terms:
        seen.append(values(made))
        flat = made.normals.sum() + made.colours.sum() + made.log_scales.sum()
        return {"slope": (1.0, made.positions[:, 2].sum() + flat)}

    made = fresh()
    run(made, slope, tmp_path / "s.pt", dataclasses.replace(SETTINGS, smoothing=smoothing))
    seen.append(values(made))
    shares = [0.1 + 0.9 * (1 + math.cos(math.pi * step / 12)) / 2 for step in range(12)]
    assert shares[0] == 1
    assert shares[6] == pytest.approx(0.55)
    for name, rate in RATE_OF.items():
        for step, share in enumerate(shares):
            expected = torch.full_like(seen[0][name], -share * getattr(RATES, rate))
            if name == "positions":
                expected[:, :2] = 0
            moved = seen[step + 1][name] - seen[step][name]
            torch.testing.assert_close(moved, expected, rtol=1e-4, atol=6e-7, msg=f"{name} at step {step}")


@pytest.mark.parametrize("part", RATE_OF)
@pytest.mark.parametrize("smoothing", [0, 1])
def test_what_has_rate_0_keeps_its_bits(tmp_path: Path, part: str, smoothing: int) -> None:
    made, settings = fresh(), dataclasses.replace(SETTINGS, steps=3, smoothing=smoothing)
    before = values(made)
    held = dataclasses.replace(RATES, **{RATE_OF[part]: 0.0})
    run(made, pull, tmp_path / "s.pt", dataclasses.replace(settings, rates=held))
    assert [name for name, value in values(made).items() if torch.equal(value, before[name])] == [part]
    assert getattr(made, part).grad is None


def test_rates_that_are_all_0_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="every rate is 0"):
        run(fresh(), pull, tmp_path / "s.pt", dataclasses.replace(SETTINGS, rates=Rates(0.0, 0.0, 0.0, 0.0, 0.0)))


def test_positions_take_the_spread_direction(tmp_path: Path) -> None:
    """One push moves the neighbours at rest and the mirror image, in proportion, and the largest row by the rate."""
    push, rings = torch.zeros_like(START.positions), []
    push[100] = torch.tensor([1.0, -2.0, 0.5])

    def pushed(made: Surface, step: int, blend: Tensor, ring: Tensor) -> Terms:
        rings.append(ring)
        return {"push": (1.0, (made.positions * push).sum())}

    made = fresh()
    run(made, pushed, tmp_path / "s.pt", dataclasses.replace(SETTINGS, steps=1))
    spread = Sobolev.of(START.rest_positions, rings[0], 1, LEFT, 0.5)(push)
    assert 5 < int((spread.norm(dim=1) > 0).sum()) < 30
    expected = -RATES.positions * spread / spread.norm(dim=1).max()
    torch.testing.assert_close(made.positions.detach() - START.positions, expected, rtol=0, atol=2e-7)


# --- terms and curves -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("up", "down"), [(2.0, 1.0), (1.0, 2.0)])
def test_weights_decide_between_terms(tmp_path: Path, up: float, down: float) -> None:
    made = fresh()
    before = values(made)["colours"]

    def torn(made: Surface, *_: object) -> Terms:
        return {"up": (up, -made.colours.sum()), "down": (down, made.colours.sum())}

    run(made, torn, tmp_path / "s.pt", dataclasses.replace(SETTINGS, steps=1))
    expected = math.copysign(RATES.colours, up - down)
    torch.testing.assert_close(made.colours.detach() - before, torch.full_like(before, expected), rtol=1e-4, atol=1e-7)


def test_curves_hold_unweighted_values_of_the_steps_that_had_the_term(tmp_path: Path) -> None:
    def counted(made: Surface, step: int, *_: object) -> Terms:
        nothing = 0 * made.colours.sum()
        terms = {"always": (2.0, nothing + step)}
        return terms | ({"third": (0.5, nothing - 10 * step)} if step % 3 == 0 else {})

    curves = run(fresh(), counted, tmp_path / "s.pt")
    assert curves == {"always": [float(step) for step in range(12)], "third": [0.0, -30.0, -60.0, -90.0]}


def test_a_look_is_given_neighbours_at_rest_and_weights_that_are_renewed_in_time(tmp_path: Path) -> None:
    seen: list[tuple[Tensor, Tensor, Tensor]] = []

    def watched(made: Surface, step: int, blend: Tensor, ring: Tensor) -> Terms:
        seen.append((made.positions.detach().clone(), blend, ring))
        return pull(made, step, blend, ring)

    run(fresh(), watched, tmp_path / "s.pt")
    for step, (_, blend, _) in enumerate(seen):
        renewed = ARTICULATION.blend(seen[step // 4 * 4][0], START.neighbours)
        assert torch.equal(blend, renewed), step
        assert step < 4 or not torch.equal(blend, seen[step - 4][1])
    ring, rest = seen[0][2], START.rest_positions
    assert ring.shape == (len(rest), 1 + SETTINGS.laplacian_neighbours)
    assert torch.equal(ring[:, 0], torch.arange(len(rest)))
    distances = (rest[ring] - rest[:, None]).norm(dim=2)
    nearest = torch.cdist(rest, rest, compute_mode="donot_use_mm_for_euclid_dist").topk(5, largest=False).values
    torch.testing.assert_close(distances, nearest)


# --- killed runs ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("smoothing", [0, 1])
def test_a_killed_run_goes_on_where_it_was_and_ends_with_the_same_bits(tmp_path: Path, smoothing: int) -> None:
    settings = dataclasses.replace(SETTINGS, smoothing=smoothing)
    whole = fresh()
    curves = run(whole, pull, tmp_path / "whole.pt", settings)
    asked: list[int] = []

    def dying(made: Surface, step: int, blend: Tensor, ring: Tensor) -> Terms:
        asked.append(step)
        if len(asked) == 11:
            raise KeyboardInterrupt
        return pull(made, step, blend, ring)

    with pytest.raises(KeyboardInterrupt):
        run(fresh(), dying, tmp_path / "killed.pt", settings)
    assert asked == list(range(11))
    again = fresh()
    assert run(again, dying, tmp_path / "killed.pt", settings) == curves
    assert asked[11:] == [10, 11]  # between two renewals of the skinning weights
    assert same(values(again), values(whole))
    # What has ended is only read.
    ended = fresh()
    assert run(ended, dying, tmp_path / "killed.pt", settings) == curves
    assert len(asked) == 13
    assert same(values(ended), values(whole))


def test_a_save_that_is_not_due_waits_but_the_end_is_always_kept(tmp_path: Path) -> None:
    asked: list[int] = []

    def dying(made: Surface, step: int, blend: Tensor, ring: Tensor) -> Terms:
        asked.append(step)
        if len(asked) == 11:
            raise KeyboardInterrupt
        return pull(made, step, blend, ring)

    path = tmp_path / "s.pt"
    with pytest.raises(KeyboardInterrupt):
        run(fresh(), dying, path, NEVER_DUE)
    assert not path.exists()
    run(fresh(), dying, path, NEVER_DUE)
    assert asked[11:] == list(range(12))
    state = Checkpoint(path, "toy", 0.0).load()
    assert state is not None
    assert state["step"] == 12


# --- numbers that are none --------------------------------------------------------------------------------------------


def bad_term(number: float) -> Look:
    return lambda made, *_: {"bad": (0.5, number + made.colours.sum())}


def bad_gradient(made: Surface, *_: object) -> Terms:
    return {"bad": (0.5, (0 * made.normals.sum()).sqrt())}


def refusing(*_: object) -> Terms:
    raise NumericalError("the prior gave NaN or infinity")


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        (bad_term(math.nan), "toy stopped at step 7: loss term bad is not finite"),
        (bad_term(-math.inf), "toy stopped at step 7: loss term bad is not finite"),
        (bad_gradient, "toy stopped at step 7: gradient of normals is not finite"),
        (refusing, "the prior gave NaN or infinity"),
    ],
    ids=["nan", "infinite", "gradient", "look"],
)
def test_the_culprit_is_named_and_the_run_can_go_on_from_before_it(tmp_path: Path, fault: Look, says: str) -> None:
    before: dict[str, Tensor] = {}

    def failing(made: Surface, step: int, blend: Tensor, ring: Tensor) -> Terms:
        before.update(values(made))
        return pull(made, step, blend, ring) | (fault(made, step, blend, ring) if step == 7 else {})

    path, made = tmp_path / "s.pt", fresh()
    with pytest.raises(NumericalError) as caught:
        run(made, failing, path, NEVER_DUE)
    assert str(caught.value).startswith(says)
    assert fault is refusing or str(path) in str(caught.value)
    assert same(values(made), before)

    state = Checkpoint(path, "toy", 0.0).load()
    assert state is not None
    assert state["step"] == 7
    assert same(state["surface"], before)
    moments = [entry for optimiser in state["optimisers"] for entry in optimiser["state"].values()]
    assert len(moments) == len(RATE_OF)
    assert sorted({int(entry["step"]) for entry in moments}) == [3, 7]  # the radii were pulled at odd steps only
    assert {name: len(curve) for name, curve in state["curves"].items()} == {
        "place": 7, "turn": 7, "colour": 7, "size": 3,
    }  # fmt: skip

    # Cured, it ends as if nothing had been.
    whole, cured = fresh(), fresh()
    curves = run(whole, pull, tmp_path / "whole.pt", NEVER_DUE)
    assert run(cured, pull, path, NEVER_DUE) == curves
    assert same(values(cured), values(whole))


def test_all_culprits_are_named_and_only_they(tmp_path: Path) -> None:
    def failing(made: Surface, *_: object) -> Terms:
        flat = made.colours.sum()
        return {"fine": (1.0, flat), "first": (1.0, flat * math.nan), "second": (2.0, flat + math.inf)}

    with pytest.raises(NumericalError, match="at step 0: loss term first, second is not finite"):
        run(fresh(), failing, tmp_path / "s.pt")
