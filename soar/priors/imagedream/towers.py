"""Autoencoder and CLIP towers: parts of diffusers and transformers, and where the checkpoint keeps their weights.

The released files name the autoencoder's weights as the latent diffusion code does, and the towers' as OpenCLIP does.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from soar.priors.imagedream.checkpoint import Entry
from soar.priors.imagedream.extra import extra
from soar.priors.imagedream.tokens import LENGTH

_AUTOENCODER = (
    (r"(encoder)\.down_blocks\.(\d)", r"\1.down.\2"),
    (r"(decoder)\.up_blocks\.(\d)", r"\1.up.\2"),
    (r"\.resnets\.", r".block."),
    (r"\.(down|up)samplers\.0\.", r".\1sample."),
    (r"\.mid_block\.block\.0\.", r".mid.block_1."),
    (r"\.mid_block\.block\.1\.", r".mid.block_2."),
    (r"\.mid_block\.attentions\.0\.group_norm", r".mid.attn_1.norm"),
    (r"\.mid_block\.attentions\.0\.to_([qkv])\.", r".mid.attn_1.\1."),
    (r"\.mid_block\.attentions\.0\.to_out\.0\.", r".mid.attn_1.proj_out."),
    (r"conv_shortcut", r"nin_shortcut"),
    (r"conv_norm_out", r"norm_out"),
)
_TOWER = (
    (r"^embeddings\.token_embedding\.", r"token_embedding."),
    (r"^embeddings\.position_embedding\.weight", r"positional_embedding"),
    (r"^embeddings\.class_embedding", r"class_embedding"),
    (r"^embeddings\.patch_embedding\.", r"conv1."),
    (r"^pre_layrnorm\.", r"ln_pre."),
    (r"^post_layernorm\.", r"ln_post."),
    (r"^final_layer_norm\.", r"ln_final."),
    (r"^encoder\.layers\.", r"transformer.resblocks."),
    (r"\.self_attn\.[qkv]_proj\.", r".attn.in_proj_"),  # the three are one tensor, in this order
    (r"\.self_attn\.out_proj\.", r".attn.out_proj."),
    (r"\.layer_norm([12])\.", r".ln_\1."),
    (r"\.mlp\.fc1\.", r".mlp.c_fc."),
    (r"\.mlp\.fc2\.", r".mlp.c_proj."),
)


class Autoencoder(nn.Module):
    """The KL autoencoder of Stable Diffusion: pictures (N, 3, S, S) in [-1, 1], latents (N, 4, S/8, S/8).

    Args:
        widths: channels at 1, 1/2, 1/4 and 1/8 of the picture's resolution.
    """

    def __init__(self, widths: Sequence[int] = (128, 256, 512, 512)) -> None:
        super().__init__()
        self.network = extra("diffusers").AutoencoderKL(
            down_block_types=["DownEncoderBlock2D"] * len(widths),
            up_block_types=["UpDecoderBlock2D"] * len(widths),
            block_out_channels=list(widths),
            layers_per_block=2,
            latent_channels=4,
        )

    def encode(self, picture: Tensor) -> Tensor:
        """Mean and logarithm of the variance of the latent, (N, 8, S/8, S/8), not scaled."""
        return self.network.quant_conv(self.network.encoder(picture))

    def decode(self, latent: Tensor) -> Tensor:
        """The picture of a latent that is not scaled."""
        return self.network.decoder(self.network.post_quant_conv(latent))

    def layout(self) -> dict[str, Entry]:
        """Where the checkpoint keeps the weights."""
        last = len(self.network.config.block_out_channels) - 1
        found = {}
        for target, value in self.network.state_dict().items():
            key = _renamed(target, _AUTOENCODER)
            # The decoder's resolutions are counted from the other end; linear layers were 1 x 1 convolutions.
            key = re.sub(r"^decoder\.up\.(\d)", lambda match: f"decoder.up.{last - int(match[1])}", key)
            shape = tuple(value.shape)
            if re.search(r"\.attn_1\.(q|k|v|proj_out)\.weight$", key):
                shape += (1, 1)
            found[key] = Entry(shape, (f"network.{target}",))
        return found


class TextTower(nn.Module):
    """ViT-H/14's text tower without its last block, whose output ImageDream does not use.

    Args:
        width, heads, blocks, vocabulary: its size.
    """

    def __init__(self, width: int = 1024, heads: int = 16, blocks: int = 23, vocabulary: int = 49408) -> None:
        super().__init__()
        transformers = extra("transformers")
        self.network = transformers.CLIPTextModel(
            transformers.CLIPTextConfig(
                vocab_size=vocabulary,
                hidden_size=width,
                intermediate_size=4 * width,
                num_hidden_layers=blocks,
                num_attention_heads=heads,
                max_position_embeddings=LENGTH,
                hidden_act="gelu",
                bos_token_id=vocabulary - 2,
                eos_token_id=vocabulary - 1,
            )
        )
        self.network.embeddings.position_ids = _positions(LENGTH)

    def forward(self, input_ids: Tensor) -> Tensor:
        """(B, 77) token numbers to (B, 77, width), normalised."""
        return self.network(input_ids).last_hidden_state

    def layout(self) -> dict[str, Entry]:
        """Where the checkpoint keeps the weights."""
        return _tower(self.network, "")

    def spare(self, key: str) -> bool:
        """Whether a key of OpenCLIP is of no use here."""
        last = f"transformer.resblocks.{self.network.config.num_hidden_layers}."
        return key.startswith(("visual.", last)) or key in ("text_projection", "logit_scale", "attn_mask")


class ImageTower(nn.Module):
    """ViT-H/14's image tower without its last block, whose output ImageDream does not use.

    Args:
        width, heads, blocks, side, patch: its size; ``side`` and ``patch`` in pixels.
    """

    def __init__(self, width: int = 1280, heads: int = 16, blocks: int = 31, side: int = 224, patch: int = 14) -> None:
        super().__init__()
        transformers = extra("transformers")
        self.network = transformers.CLIPVisionModel(
            transformers.CLIPVisionConfig(
                hidden_size=width,
                intermediate_size=4 * width,
                num_hidden_layers=blocks,
                num_attention_heads=heads,
                image_size=side,
                patch_size=patch,
                hidden_act="gelu",
            )
        )
        self.network.embeddings.position_ids = _positions((side // patch) ** 2 + 1)

    def forward(self, pixel_values: Tensor) -> Tensor:
        """Normalised pictures (B, 3, side, side) to (B, 1 + patches, width), as the last block leaves them."""
        return self.network(pixel_values).last_hidden_state

    def layout(self) -> dict[str, Entry]:
        """Where the checkpoint keeps the weights."""
        return _tower(self.network, "visual.")

    def spare(self, key: str) -> bool:
        """Whether a key of OpenCLIP is of no use here."""
        last = f"visual.transformer.resblocks.{self.network.config.num_hidden_layers}."
        return not key.startswith("visual.") or key.startswith(last) or key == "visual.proj"


def _tower(network: nn.Module, prefix: str) -> dict[str, Entry]:
    """Entries of a CLIP tower; queries, keys and values of a layer share one."""
    groups: dict[str, list[str]] = defaultdict(list)
    state = network.state_dict()
    for target in sorted(state, key=lambda name: (".q_proj" not in name, ".k_proj" not in name)):
        groups[prefix + _renamed(target, _TOWER)].append(target)
    return {
        key: Entry(
            (len(targets) * state[targets[0]].shape[0], *state[targets[0]].shape[1:]),
            tuple(f"network.{target}" for target in targets),
        )
        for key, targets in groups.items()
    }


def _renamed(key: str, rules: Sequence[tuple[str, str]]) -> str:
    for pattern, replacement in rules:
        key = re.sub(pattern, replacement, key)
    return key


def _positions(count: int) -> Tensor:
    """0, 1, ... as (1, count), on the processor even while weights are only planned: no checkpoint holds them."""
    return torch.arange(count, device="cpu")[None]
