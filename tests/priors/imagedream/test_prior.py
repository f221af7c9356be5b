"""The provider: prompts, guidance, and that its loss is score distillation up to the stated weight."""

import dataclasses

import pytest
import torch

from soar.errors import ConfigError, InputError, NumericalError
from soar.priors.imagedream import schedule
from soar.priors.imagedream.cameras import embedding
from soar.priors.imagedream.networks import TorchNetworks
from soar.priors.imagedream.prior import FRAMES, SCALE, ImageDream
from soar.priors.protocol import VIEWS
from tests.priors.imagedream.small import OPTIONS, SIZE, SmallNetworks, condition, generator, prior, views

TIME = 0.4


def replaced(**changes):
    return dataclasses.replace(OPTIONS, **changes)


def gradient(made, domain="colour"):
    """Of the loss with respect to the pictures."""
    shown = views()
    (prompt,) = made.prepare([condition(domain)])
    (found,) = torch.autograd.grad(made.loss(prompt, shown, TIME, generator()), shown.pictures)
    return found


def by_hand(made, scale, pictures):
    """Latents of ``pictures``, the noise that was added to them, the noise that is found, by the formulas."""
    draws = generator()
    mean, log_variance = made.networks.encode(2 * pictures - 1).chunk(2, 1)
    drawn = torch.randn(mean.shape, generator=draws)
    latent = SCALE * (mean + (log_variance / 2).exp() * drawn)
    noise = torch.randn(mean.shape, generator=draws).double()
    (prompt,) = made.prepare([condition()])
    alpha, sigma = schedule.levels(400)
    noisy = (alpha * latent + sigma * noise).detach()
    frames = made.networks.frames
    camera = torch.zeros(frames, 16)
    camera[:VIEWS] = embedding(views().azimuth, views().elevation)
    found = []
    for text, known in zip(prompt.text, (1.0, 0.0), strict=True):
        found.append(
            made.networks.unet(
                torch.cat([noisy, noisy[: frames - VIEWS]]),
                torch.full((frames,), 400),
                text.expand(frames, -1, -1),
                camera.double(),
                (known * prompt.features).expand(frames, -1, -1),
                None if frames == VIEWS else known * prompt.latent[None],
            )[:VIEWS]
        )
    conditional, unconditional = found
    return latent, noise, noisy, unconditional + scale * (conditional - unconditional), conditional


@pytest.mark.parametrize("mode", ["pixel", "local"])
def test_latent_loss_is_score_distillation_times_sigma_over_alpha(mode):
    """d loss / d picture = J^T (sigma / alpha) (eps_hat - eps) / views, J the encoder's Jacobian."""
    made, shown = prior(replaced(mode=mode)), views()
    over_grey = shown.pictures + (1 - shown.alpha) * OPTIONS.background
    latent, noise, _, guided, _ = by_hand(made, OPTIONS.guidance, over_grey)
    alpha, sigma = schedule.levels(400)
    distilled = sigma / alpha * (guided - noise) / VIEWS
    (expected,) = torch.autograd.grad(latent, shown.pictures, distilled)
    found = gradient(made)
    assert found.abs().max() > 1e-4
    torch.testing.assert_close(found, expected, atol=1e-12, rtol=1e-9)


def test_rescaling_changes_the_target_alone():
    made, shown = prior(replaced(rescale=0.3)), views()
    latent, _, noisy, guided, conditional = by_hand(
        made, OPTIONS.guidance, shown.pictures + (1 - shown.alpha) * OPTIONS.background
    )
    target = schedule.rescaled(*(schedule.clean(noisy, noise, 400) for noise in (guided, conditional)), 0.3)
    (expected,) = torch.autograd.grad(latent, shown.pictures, (latent - target).detach() / VIEWS)
    torch.testing.assert_close(gradient(made), expected, atol=1e-12, rtol=1e-9)
    assert not torch.allclose(expected, gradient(prior()), rtol=1e-3)


def test_image_loss_pulls_pictures_to_the_estimate():
    made, shown = prior(replaced(form="image")), views()
    (prompt,) = made.prepare([condition()])
    target = made.estimate(prompt, shown, TIME, generator())
    assert target.shape == (VIEWS, 3, SIZE, SIZE)
    assert not target.requires_grad
    assert 0 <= target.min() < target.max() <= 1
    difference = 2 * (shown.pictures + (1 - shown.alpha) * OPTIONS.background - target)
    loss = made.loss(prompt, shown, TIME, generator())
    torch.testing.assert_close(loss, 0.5 * difference.square().sum() / VIEWS)
    torch.testing.assert_close(gradient(made), 2 * difference.detach() / VIEWS)


def test_the_estimate_is_what_the_networks_decode():
    made, shown = prior(), views()
    over_grey = shown.pictures + (1 - shown.alpha) * OPTIONS.background
    _, _, noisy, guided, _ = by_hand(made, OPTIONS.guidance, over_grey)
    expected = (made.networks.decode(schedule.clean(noisy, guided, 400) / SCALE) + 1) / 2
    (prompt,) = made.prepare([condition()])
    torch.testing.assert_close(made.estimate(prompt, shown, TIME, generator()), expected.clamp(0, 1))


@pytest.mark.parametrize("mode", ["pixel", "local"])
def test_what_the_unet_is_asked(mode):
    made = prior(replaced(mode=mode))
    first, second = made.prepare([condition(text="a man in red"), condition(text="somebody", phase=1.0)])
    made.loss(second, views(), TIME, generator())
    ((x, steps, context, camera, ip, latent),) = [given for name, given in made.networks.asked if name == "noise"]
    frames = made.networks.frames
    assert x.shape == (2 * frames, 4, SIZE // 8, SIZE // 8)
    assert torch.equal(x[:frames], x[frames:])
    assert steps.tolist() == [400] * (2 * frames)
    assert torch.equal(context[:frames], second.text[0].expand(frames, -1, -1))
    assert torch.equal(context[frames:], second.text[1].expand(frames, -1, -1))
    assert not torch.equal(first.text[0], second.text[0])
    assert torch.equal(first.text[1], second.text[1])  # the negative prompt
    assert torch.equal(ip[:frames], second.features.expand(frames, -1, -1))
    assert not ip[frames:].any()
    assert torch.equal(camera[:frames], camera[frames:])
    assert torch.equal(camera[:VIEWS], embedding(views().azimuth, views().elevation))
    if mode == "pixel":
        assert not camera[VIEWS].any()
        assert torch.equal(latent[0], second.latent)
        assert not latent[1].any()
    else:
        assert latent is None


def test_prompts_are_encoded_once_and_on_the_background():
    made = prior()
    one, two = condition(), condition(phase=1.0)
    prompts = made.prepare([one, two])
    assert [name for name, _ in made.networks.asked] == ["text", "image"]
    (ids,), (pixels,) = (given for _, given in made.networks.asked)
    assert len(ids) == 2  # the text that both have, and the negative prompt
    assert pixels.shape == (2, 3, 224, 224)
    over_grey = one.picture + (1 - one.alpha) * OPTIONS.background
    mean = made.networks.encode(2 * over_grey[None] - 1)[0, :4]
    torch.testing.assert_close(prompts[0].latent, SCALE * mean)
    assert not torch.equal(prompts[0].features, prompts[1].features)


def test_normals_are_shown_with_y_up_and_z_to_the_viewer():
    shown, made = views(), prior(replaced(form="image"))
    flipped = torch.cat([shown.pictures[:, :1], shown.alpha - shown.pictures[:, 1:]], 1).detach().requires_grad_()
    known = condition("normal")
    as_colour = dataclasses.replace(
        known, domain="colour", picture=torch.cat([known.picture[:1], known.alpha - known.picture[1:]])
    )
    normal, colour = made.prepare([known, as_colour])
    losses = [
        made.loss(prompt, dataclasses.replace(shown, pictures=pictures), TIME, generator())
        for prompt, pictures in ((normal, shown.pictures), (colour, flipped))
    ]
    torch.testing.assert_close(*losses)
    here, there = (torch.autograd.grad(loss, x)[0] for loss, x in zip(losses, (shown.pictures, flipped), strict=True))
    torch.testing.assert_close(here * torch.tensor([1, -1, -1.0])[:, None, None], there)
    estimates = [
        made.estimate(prompt, dataclasses.replace(shown, pictures=pictures), TIME, generator())
        for prompt, pictures in ((normal, shown.pictures), (colour, flipped))
    ]
    torch.testing.assert_close(estimates[0][:, 0], estimates[1][:, 0])
    torch.testing.assert_close(estimates[0][:, 1:], 1 - estimates[1][:, 1:])


def test_alpha_takes_part_where_the_background_shows():
    made, shown = prior(), views()
    shown = dataclasses.replace(shown, alpha=shown.alpha.requires_grad_())
    (prompt,) = made.prepare([condition()])
    made.loss(prompt, shown, TIME, generator()).backward()
    over_grey = shown.pictures.grad.sum(1, keepdim=True) * -OPTIONS.background
    torch.testing.assert_close(shown.alpha.grad, over_grey)


def test_the_generator_decides():
    made, shown = prior(), views()
    (prompt,) = made.prepare([condition()])
    first, second = (made.loss(prompt, shown, TIME, generator()) for _ in range(2))
    assert torch.equal(first, second)
    assert not torch.equal(first, made.loss(prompt, shown, TIME, torch.Generator().manual_seed(8)))


@pytest.mark.parametrize("form", ["latent", "image"])
def test_half_precision_is_near(form):
    """As on an accelerator: weights and activations of the networks are halves, the loss is not."""
    options = replaced(form=form)
    halves = TorchNetworks(RefusesToLoad(), FRAMES[options.mode], torch.device("cpu"))
    small = SmallNetworks(options.mode, torch.float16)
    halves.dtype, halves.unet, halves.autoencoder = torch.float16, small.unet, small.autoencoder
    exact, (prompt,) = prior(options), prior(options).prepare([condition()])
    shown = dataclasses.replace(views(), pictures=views().pictures.detach().float().requires_grad_())
    shown = dataclasses.replace(shown, alpha=shown.alpha.float())
    loss = ImageDream(options, halves, exact.tokens, exact.device, SIZE).loss(prompt, shown, TIME, generator())
    assert loss.dtype == torch.float32
    torch.testing.assert_close(loss, exact.loss(prompt, views(), TIME, generator()).float(), rtol=0.02, atol=0)
    (found,) = torch.autograd.grad(loss, shown.pictures)
    assert torch.nn.functional.cosine_similarity(found.flatten(), gradient(exact).float().flatten(), 0) > 0.95


class RefusesToLoad:
    def load(self, *_):
        raise AssertionError("these networks are given")


class Broken(SmallNetworks):
    def noise(self, *given):
        return torch.full_like(super().noise(*given), torch.nan)


def test_nan_has_a_name():
    made = prior(networks=Broken())
    (prompt,) = made.prepare([condition()])
    with pytest.raises(NumericalError, match="NaN") as caught:
        made.loss(prompt, views(), TIME, generator())
    assert "device=cpu" in caught.value.cure


def test_pictures_of_another_size_are_refused():
    made = prior()
    (prompt,) = made.prepare([condition()])
    small = dataclasses.replace(views(), pictures=torch.zeros(4, 3, 32, 32), alpha=torch.zeros(4, 1, 32, 32))
    with pytest.raises(InputError, match="do not fit"):
        made.loss(prompt, small, TIME, generator())


def test_networks_of_the_other_mode_are_refused():
    with pytest.raises(ConfigError, match="another mode"):
        prior(replaced(mode="local"), SmallNetworks("pixel"))
