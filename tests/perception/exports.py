"""Networks of known answers, with the names, ranks and axes of the exports that people have, and a picture for them.

The person is red, the rest blue. Every network finds red, each in its own way.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from soar.body.openpose import BODY, INDEX
from soar.perception.roi import Roi
from soar.workflow.configuration import composed

RED, BLUE = (230, 30, 40), (40, 30, 230)
MEAN, STD = torch.tensor([123.675, 116.28, 103.53])[:, None, None], torch.tensor([58.395, 57.12, 57.375])[:, None, None]


def scene(height: int, width: int) -> tuple[np.ndarray, np.ndarray, Roi, np.ndarray]:
    """A picture with a person off its centre, and somebody else; the person's mask (H, W) bool, region and body."""
    image = np.full((height, width, 3), BLUE, np.uint8)
    y0, y1, x0, x1 = (round(s * share) for s, share in ((height, 0.2), (height, 0.75), (width, 0.15), (width, 0.45)))
    truth = np.zeros((height, width), bool)
    truth[y0:y1, x0:x1] = True
    image[truth] = RED
    image[round(0.3 * height) : y1, round(0.7 * width) : round(0.85 * width)] = RED
    body = np.zeros((len(BODY), 3))
    body[:, 2] = 0.9
    body[:, 0] = (x0 + x1) / 2
    for name, i in INDEX.items():
        if i < len(BODY):
            side = name.startswith("left") - name.startswith("right")
            body[i, 0] += side * 0.45 * (x1 - x0)
    ladder = {"nose": 0.05, "neck": 0.2, "shoulder": 0.2, "elbow": 0.3, "wrist": 0.4, "hip": 0.5, "knee": 0.7}
    for name, i in INDEX.items():
        if i < len(BODY):
            share = next(
                (v for part, v in ladder.items() if part in name), 0.05 if name.endswith(("eye", "ear")) else 0.95
            )
            body[i, 1] = y0 + share * (y1 - y0)
    return image, truth, Roi((x0 + x1) / 2, (y0 + y1) / 2, 1.4 * (y1 - y0), 0.0), body


def overlap(alpha: np.ndarray, truth: np.ndarray) -> float:
    """Intersection over union of the mask and the truth."""
    found = alpha > 0.5
    return float((found & truth).sum() / (found | truth).sum())


def masks_node(option: str, **changes: Any) -> dict[str, Any]:
    """The node ``masks`` of an option, with changes; on the processor. A network of one's own takes 96 x 128 pixels."""
    size = ("masks.size=[96, 128]",) if option == "network" else ()
    return composed((f"masks={option}", *size))["masks"] | {"device": "cpu"} | changes


def export(module: nn.Module, path: Path, inputs: Mapping[str, Tensor], outputs: list[str], **free: Any) -> Path:
    """Write a module as ONNX; ``free`` maps a tensor to the names of its free axes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's, about itself
        torch.onnx.export(
            module.eval(), tuple(inputs.values()), str(path), input_names=list(inputs), output_names=outputs,
            dynamic_axes=free, opset_version=17, dynamo=False,
        )  # fmt: skip
    return path


# Segment Anything


def _features(normalised: Tensor, planes: int, cell: int) -> Tensor:
    """Colour per ``cell`` pixels, in the first of ``planes`` channels."""
    return F.pad(F.avg_pool2d(normalised, cell), (0, 0, 0, 0, 0, planes - 3))


class SamEncoder(nn.Module):
    """A picture of SAM's, normalised and padded, to the embedding."""

    def forward(self, images: Tensor) -> Tensor:
        return _features(images, 256, 16)


class SamEncoderWithPreprocessing(nn.Module):
    """A picture (h, w, 3) of 0 to 255 with a longer side of at most 1024."""

    def forward(self, input_image: Tensor) -> Tensor:
        picture = (input_image.permute(2, 0, 1)[None] - MEAN) / STD
        padded = F.pad(picture, (0, 1024 - picture.shape[3], 0, 1024 - picture.shape[2]))
        return _features(padded, 256, 16)


class Sam2Encoder(nn.Module):
    """A picture stretched to the square, normalised."""

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        fine = _features(image, 32, 4), _features(image, 64, 8)
        return (*fine, _features(image, 256, 16))


def _offered(colours: Tensor, coords: Tensor, labels: Tensor, earlier: Tensor) -> tuple[Tensor, Tensor]:
    """What a decoder offers (1, 4, 256, 256): everything; what is red in the box; its upper half, which leaves half of
    the person out; the box's rows over the whole width, which hold the background. The right one is predicted to be the
    worst.
    """
    rgb = F.interpolate(colours, (256, 256), mode="bilinear", align_corners=False) * STD + MEAN
    red = (rgb[:, :1] - rgb[:, 2:]) / 10
    low, high = ((coords * (labels == k).to(coords.dtype)[..., None]).sum(1) for k in (2, 3))
    centre = (torch.arange(256) + 0.5) * 4
    x, y = centre[None, None, None, :], centre[None, None, :, None]
    rows = ((y >= low[:, 1]) & (y <= high[:, 1])).to(red.dtype)
    box = rows * ((x >= low[:, 0]) & (x <= high[:, 0])).to(red.dtype)
    upper = box * (y <= (low[:, 1] + high[:, 1]) / 2).to(red.dtype)
    logits = torch.cat(
        [torch.full_like(red, 9.0), red * box - 9 * (1 - box), red * upper - 9 * (1 - upper), 18 * rows - 9 + 0 * red],
        1,
    )
    # Without points where the person is, or with an earlier mask, there is nothing.
    points = (labels == 1).to(coords.dtype).sum()
    quality = torch.tensor([[0.9, 0.8, 0.95, 0.99]]) + 0 * red.mean()
    return logits - 100 * earlier - 100 * (points < 20).to(red.dtype), quality


class SamDecoder(nn.Module):
    """The decoder of the official export: masks at ``orig_im_size``, from whose shape follows what was padding."""

    def forward(self, image_embeddings, point_coords, point_labels, mask_input, has_mask_input, orig_im_size):
        low, quality = _offered(image_embeddings[:, :3], point_coords, point_labels, has_mask_input + mask_input.mean())
        large = F.interpolate(low, (1024, 1024), mode="bilinear", align_corners=False)
        size = torch.floor(orig_im_size * (1024 / torch.max(orig_im_size)) + 0.5).to(torch.int64)
        cut, final = large[..., : size[0], : size[1]], orig_im_size.to(torch.int64)
        return F.interpolate(cut, (final[0], final[1]), mode="bilinear", align_corners=False), quality, low


class Sam2Decoder(nn.Module):
    """The decoder of samexporter: three masks of 256 x 256."""

    def forward(
        self, image_embed, high_res_feats_0, high_res_feats_1, point_coords, point_labels, mask_input, has_mask_input
    ):
        earlier = has_mask_input + mask_input.mean() + 0 * (image_embed.mean() + high_res_feats_1.mean())
        low, quality = _offered(high_res_feats_0[:, :3], point_coords, point_labels, earlier)
        return low[:, 1:].clamp(-32, 32), quality[:, 1:]


class Sam2RuntimeDecoder(nn.Module):
    """The decoder of onnxruntime's tools: masks at the size asked for."""

    def forward(
        self, image_features_0, image_features_1, image_embeddings, point_coords, point_labels, input_masks,
        has_input_masks, original_image_size,
    ):  # fmt: skip
        earlier = has_input_masks.mean() + input_masks.mean() + 0 * (image_embeddings.mean() + image_features_1.mean())
        low, quality = _offered(image_features_0[:, :3], point_coords, point_labels, earlier)
        size = (original_image_size[0], original_image_size[1])
        masks = F.interpolate(low[:, 1:], size, mode="bilinear", align_corners=False)
        return masks, quality[:, 1:], low[:, 1:]


_POINTS = {"point_coords": torch.ones(1, 5, 2), "point_labels": torch.ones(1, 5)}
_NUMBERS = {"point_coords": {1: "num_points"}, "point_labels": {1: "num_points"}}


def sam_decoder(module: nn.Module, path: Path) -> Path:
    """A decoder as the official script exports it."""
    inputs = {
        "image_embeddings": torch.rand(1, 256, 64, 64), **_POINTS, "mask_input": torch.zeros(1, 1, 256, 256),
        "has_mask_input": torch.zeros(1), "orig_im_size": torch.tensor([600.0, 800.0]),
    }  # fmt: skip
    return export(module, path, inputs, ["masks", "iou_predictions", "low_res_masks"], **_NUMBERS)


def sam_pair(folder: Path, kind: str) -> dict[str, Path]:
    """``encoder`` and ``decoder`` of a kind: sam, sam_own (an encoder with preprocessing), sam_fixed (the same with an
    input of 684 x 1024), sam2, sam2_runtime.
    """
    folder.mkdir(parents=True, exist_ok=True)
    encoder, decoder = folder / "encoder.onnx", folder / "decoder.onnx"
    square = torch.rand(1, 3, 1024, 1024)
    if kind in ("sam", "sam_own", "sam_fixed"):
        if kind == "sam":
            export(SamEncoder(), encoder, {"images": square}, ["embeddings"])
        else:
            free = {"input_image": {0: "image_height", 1: "image_width"}} if kind == "sam_own" else {}
            picture = {"input_image": torch.rand(684, 1024, 3)}
            export(SamEncoderWithPreprocessing(), encoder, picture, ["image_embeddings"], **free)
        return {"encoder": encoder, "decoder": sam_decoder(SamDecoder(), decoder)}
    sizes = ((32, 256), (64, 128), (256, 64))
    features = [torch.rand(1, planes, side, side) for planes, side in sizes]
    if kind == "sam2":
        names = ["high_res_feats_0", "high_res_feats_1", "image_embed"]
        inputs = {
            "image_embed": features[2], "high_res_feats_0": features[0], "high_res_feats_1": features[1], **_POINTS,
            "mask_input": torch.zeros(1, 1, 256, 256), "has_mask_input": torch.zeros(1),
        }  # fmt: skip
        free = {name: {0: "num_labels", **axes} for name, axes in _NUMBERS.items()}
        export(Sam2Decoder(), decoder, inputs, ["masks", "iou_predictions"], **free)
    else:
        names = ["image_features_0", "image_features_1", "image_embeddings"]
        inputs = {
            **dict(zip(names, features, strict=True)), "point_coords": _POINTS["point_coords"],
            "point_labels": torch.ones(1, 5, dtype=torch.int32), "input_masks": torch.zeros(1, 1, 256, 256),
            "has_input_masks": torch.zeros(1, 1), "original_image_size": torch.tensor([600, 800], dtype=torch.int32),
        }  # fmt: skip
        export(Sam2RuntimeDecoder(), decoder, inputs, ["masks", "iou_predictions", "low_res_masks"], **_NUMBERS)
    export(Sam2Encoder(), encoder, {"image": square}, names)
    return {"encoder": encoder, "decoder": decoder}


# Networks from a picture to a map


class Finder(nn.Module):
    """Tells what is red, if it is given colours as its description says, in the form that the description says.

    Args:
        node: the node ``masks``.
        outputs: how many there are; the others are nothing.
        coarse: edge of the pixels that one pixel of the output stands for.
    """

    def __init__(self, node: Mapping[str, Any], outputs: int = 1, coarse: int = 1) -> None:
        super().__init__()
        self.node, self.others, self.coarse = node, outputs - 1, coarse

    def forward(self, picture: Tensor) -> tuple[Tensor, ...]:
        node = self.node
        if node["layout"] == "nhwc":
            picture = picture.permute(0, 3, 1, 2)
        mean, std = (torch.tensor(node[key])[:, None, None] for key in ("mean", "std"))
        colours = picture * std + mean
        brightest = 1.0 if node["divide_by"] == "maximum" else max(RED) / node["divide_by"]
        red = colours[:, 2:] if node["colours"] == "bgr" else colours[:, :1]
        # One where red is as bright as it should be, zero well before and well after.
        found = F.avg_pool2d(1.5 - 4 * (red - brightest).abs() / brightest, self.coarse).clamp(0, 1)
        if node["activation"] == "sigmoid":
            found = 40 * found - 20
        elif node["activation"] == "softmax":
            found = torch.cat([10 - 20 * found, 20 * found - 10], 1)
        elif node["activation"] != "none":
            found = 0.05 + 0.8 * found
        if node["layout"] == "nhwc":
            found = found.permute(0, 2, 3, 1)
        return (found, *(0 * found - 3 for _ in range(self.others)))


class VideoFinder(Finder):
    """With four states that count the frames; alpha grows with them, and is nothing at another ``downsample_ratio``."""

    def forward(self, src, r1i, r2i, r3i, r4i, downsample_ratio):
        (found,) = super().forward(src)
        right = ((downsample_ratio - 0.6).abs() < 1e-6).to(src.dtype)
        counted = [state + torch.ones(1, 2, 3, 4) for state in (r1i, r2i, r3i, r4i)]
        pha = found * right * (0.5 + 0.1 * torch.stack([state.mean() for state in counted]).mean())
        return 0 * src, pha, *counted


def finder(node: Mapping[str, Any], path: Path, names: tuple[str, str], outputs: int = 1, coarse: int = 1) -> Path:
    """A :class:`Finder` as ONNX; ``names`` of its input and of its first output."""
    size = node["size"]
    height, width = (64, 96) if isinstance(size, Mapping) else size
    picture = torch.rand(1, height, width, 3) if node["layout"] == "nhwc" else torch.rand(1, 3, height, width)
    axes = {1: "h", 2: "w"} if node["layout"] == "nhwc" else {2: "h", 3: "w"}
    free = {names[0]: axes} if isinstance(size, Mapping) else {}
    given = [names[1], *(f"d{i}" for i in range(1, outputs))]
    return export(Finder(node, outputs, coarse), path, {names[0]: picture}, given, **free)


def video_finder(node: Mapping[str, Any], path: Path) -> Path:
    """A :class:`VideoFinder` as ONNX, named as Robust Video Matting."""
    states = [f"r{i}i" for i in (1, 2, 3, 4)]
    picture = {"src": torch.rand(1, 3, 64, 96)}
    inputs = picture | {name: torch.zeros(1, 1, 1, 1) for name in states} | {"downsample_ratio": torch.tensor([0.6])}
    axes = {i: f"{i}" for i in range(4)}
    free = dict.fromkeys(("src", *states), axes)
    return export(VideoFinder(node), path, inputs, ["fgr", "pha", "r1o", "r2o", "r3o", "r4o"], **free)
