"""The attribute field: ranges, start, prefit, chunks."""

import dataclasses

import torch

from soar.avatar.field import Field, prefit
from soar.avatar.surfels import Avatar, from_body
from tests.avatar import toy


def start() -> Avatar:
    avatar = from_body(toy.body(), toy.motion().betas, toy.avatar_settings(subdivisions=1))
    return avatar.replace(colours=torch.rand(len(avatar), 3, generator=torch.Generator().manual_seed(3)) * 0.8 + 0.1)


def field_of(avatar: Avatar, **changes: object) -> Field:
    settings = dataclasses.replace(toy.FIELD, **changes)
    return Field(avatar.positions, avatar.colours, avatar.scales, settings, torch.Generator().manual_seed(0))


def test_the_residual_field_starts_at_the_start() -> None:
    avatar = start()
    colours, scales = field_of(avatar)(avatar.positions)
    torch.testing.assert_close(colours, avatar.colours, atol=1e-5, rtol=0)
    torch.testing.assert_close(scales, avatar.scales, atol=1e-6, rtol=1e-3)


def test_prefit_brings_the_whole_field_near_the_start() -> None:
    avatar = start().replace(colours=torch.full((len(start()), 3), 0.3))
    field = field_of(avatar, residual=False, prefit_steps=200)
    before = (field(avatar.positions)[1] - avatar.scales).abs().mean()
    prefit(field, avatar.positions, avatar.normals, avatar.colours, avatar.scales)
    colours, scales = field(avatar.positions)
    assert (colours - 0.3).abs().mean() < 0.02
    assert (scales - avatar.scales).abs().mean() < 0.2 * before


def test_chunks_change_nothing() -> None:
    avatar = start()
    whole = field_of(avatar, residual=False, chunk=10**6)(avatar.positions)
    parts = field_of(avatar, residual=False, chunk=7)(avatar.positions)
    for a, b in zip(whole, parts, strict=True):
        torch.testing.assert_close(a, b, atol=1e-6, rtol=1e-5)


def test_the_same_seed_gives_the_same_field_and_every_parameter_learns() -> None:
    avatar = start()
    fields = [field_of(avatar, residual=False) for _ in range(2)]
    for a, b in zip(*(f.parameters() for f in fields), strict=True):
        assert torch.equal(a, b)
    colours, scales = fields[0](avatar.positions)
    (colours.sum() + scales.sum()).backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in fields[0].parameters())
