"""Files as other tools write them, of a known person; nothing of theirs is copied but names, shapes and conventions."""

from __future__ import annotations

import io
import json
import pickle
import sys
import types
import zlib
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from soar.body.parameters import HandSpace, axis_angles, matrices
from soar.geometry.cameras import Camera
from tests.importers.person import Truth

Hands = HandSpace


def _from_mean(what: Truth, hands: Hands) -> np.ndarray:
    return what.hands - hands.mean


def smplerx(folder: Path, what: Truth, camera: Camera, hands: Hands, person: int = 0, first: int = 1) -> Path:
    """One npz and one JSON per frame; the camera is the same in all."""
    for part in ("smplx", "meta"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    curled = _from_mean(what, hands)
    for t, frame in enumerate(what.frames + first):
        np.savez(
            folder / f"smplx/{frame:05}_{person}.npz", global_orient=what.orient[t, None], body_pose=what.body[t],
            left_hand_pose=curled[t, 0].reshape(15, 3), right_hand_pose=curled[t, 1].reshape(15, 3),
            jaw_pose=what.face[t, 0, None], leye_pose=what.face[t, 1, None], reye_pose=what.face[t, 2, None],
            betas=_ten(what.betas)[None], expression=np.zeros((1, 10)), transl=what.transl[t, None],
        )  # fmt: skip
        K = camera.K
        meta = {
            "focal": [K[0, 0], K[1, 1]], "princpt": [K[0, 2], K[1, 2]], "bbox": [0.0, 0.0, 192.0, 256.0],
            "bbox_mmdet": [0, 0, 1, 1], "bbox_id": person, "img_path": f"{frame:06}.jpg",
        }  # fmt: skip
        (folder / f"meta/{frame:05}_{person}.json").write_text(json.dumps(meta))
    return folder


def smplifyx(folder: Path, what: Truth, camera: Camera, hands: Hands) -> Path:
    """One pickle per image; 45 PCA coefficients would be angles, so hands are written as angles."""
    curled = _from_mean(what, hands)
    for t, frame in enumerate(what.frames):
        row = {
            "camera_rotation": np.eye(3, dtype=np.float32)[None], "camera_translation": what.transl[t, None],
            "betas": _ten(what.betas)[None], "global_orient": what.orient[t, None],
            "body_pose": what.body[t].reshape(1, 63), "left_hand_pose": curled[t, 0, None],
            "right_hand_pose": curled[t, 1, None], "jaw_pose": what.face[t, 0, None],
            "leye_pose": what.face[t, 1, None], "reye_pose": what.face[t, 2, None], "expression": np.zeros((1, 10)),
        }  # fmt: skip
        path = folder / f"results/img_{frame:04}/000.pkl"
        path.parent.mkdir(parents=True)
        path.write_bytes(pickle.dumps(row, protocol=2))
    return folder


def easymocap(folder: Path, what: Truth, camera: Camera, hands: Hands, pelvis: np.ndarray) -> Path:
    """One JSON per frame. The body turns about its origin, where the pelvis rests at ``pelvis``; fingers all 45."""
    (folder / "smpl").mkdir(parents=True)
    fingers = np.einsum("tsk,skn->tsn", what.hands, hands.components.swapaxes(1, 2))
    for t, frame in enumerate(what.frames):
        R = matrices(what.orient[t])
        poses = np.concatenate([np.zeros(3), what.body[t].ravel(), fingers[t].ravel(), what.face[t].ravel()])
        one = {
            "id": 0, "Rh": [what.orient[t].tolist()], "Th": [(what.transl[t] + pelvis - R @ pelvis).tolist()],
            "poses": [poses.tolist()], "expression": [[0.0] * 10], "shapes": [_ten(what.betas).tolist()],
        }  # fmt: skip
        (folder / f"smpl/{frame:06}.json").write_text(json.dumps([one]))
    return folder


def romp(folder: Path, what: Truth, camera: Camera, hands: Hands) -> Path:
    """Two npz, in a world of other axes than the camera's; ``what`` is a body of SMPL's."""
    folder.mkdir(parents=True)
    R, t = camera.R, camera.t
    rest = np.array([-0.00179506, -0.22333382, 0.02821918])
    orient = axis_angles(R.T @ matrices(what.orient))
    np.savez(
        folder / "poses.npz", betas=np.ones(10), global_orient=orient,
        body_pose=np.concatenate([what.body.reshape(-1, 63), np.ones((len(what.frames), 6))], 1),
        transl=(what.transl + rest - t) @ R - rest,
    )  # fmt: skip
    np.savez(
        folder / "cameras.npz", intrinsic=camera.K, extrinsic=camera.T_cam_from_world, height=camera.height,
        width=camera.width,
    )  # fmt: skip
    return folder


def phalp(folder: Path, what: Truth, camera: Camera, hands: Hands) -> Path:
    """One compressed joblib pickle; a track that is only remembered is somewhere else."""
    tree: dict[str, Any] = {}
    for t, frame in enumerate(what.frames):
        smpl = {
            "global_orient": matrices(what.orient[t])[None].astype(np.float32),
            "body_pose": np.concatenate([matrices(what.body[t]), np.eye(3)[None], np.eye(3)[None]]),
            "betas": np.ones(10, np.float32),
        }
        size = [camera.height, camera.width]
        tree[f"frames/{frame:06}.jpg"] = {
            "time": int(frame), "shot": 0, "tid": [7, 3], "tracked_time": [0, 2], "smpl": [smpl, smpl],
            "camera": [what.transl[t], what.transl[t] + 9], "size": [size, size], "conf": [np.float32(0.9)] * 2,
            "bbox": [np.zeros(4)] * 2, "mask": [{"size": size, "counts": "abc"}] * 2, "img_path": ["a"] * 2,
        }  # fmt: skip
    folder.mkdir(parents=True)
    (folder / "demo_clip.pkl").write_bytes(zlib.compress(joblib_dumps(tree), 3))
    return folder


def wham(folder: Path, what: Truth, camera: Camera, hands: Hands) -> Path:
    """One joblib pickle of a defaultdict."""
    people: defaultdict[int, dict[str, np.ndarray]] = defaultdict(dict)
    T = len(what.frames)
    pose = np.concatenate([what.orient, what.body.reshape(T, 63), np.zeros((T, 6))], 1)
    people[0] = {
        "pose": pose.astype(np.float32), "trans": what.transl, "pose_world": pose, "trans_world": what.transl,
        "betas": np.ones((T, 10)), "verts": np.zeros((T, 9, 3), np.float32), "frame_ids": what.frames,
    }  # fmt: skip
    folder.mkdir(parents=True)
    (folder / "wham_output.pkl").write_bytes(joblib_dumps(people))
    return folder


def gvhmr(folder: Path, what: Truth, camera: Camera, hands: Hands) -> Path:
    """One torch file."""
    T = len(what.frames)
    body = {
        "body_pose": what.body.reshape(T, 63), "betas": np.tile(_ten(what.betas), (T, 1)),
        "global_orient": what.orient, "transl": what.transl,
    }  # fmt: skip
    tensors = {key: torch.from_numpy(value).double() for key, value in body.items()}
    K = torch.from_numpy(np.tile(camera.K, (T, 1, 1)))
    world = {key: value + 1 for key, value in tensors.items()}
    folder.mkdir(parents=True)
    tree = {"smpl_params_global": world, "smpl_params_incam": tensors, "K_fullimg": K, "net_outputs": {"x": K}}
    torch.save(tree, folder / "hmr4d_results.pt")
    return folder


def params(folder: Path, what: Truth, camera: Camera, hands: Hands) -> Path:
    """``params.pth`` of the released code."""
    T = len(what.frames)
    curled = _from_mean(what, hands)
    fields = {
        "betas": _ten(what.betas)[None], "body_pose": what.body.reshape(T, 63), "global_orient": what.orient,
        "left_hand_pose": curled[:, 0], "right_hand_pose": curled[:, 1], "jaw_pose": what.face[:, 0],
        "leye_pose": what.face[:, 1], "reye_pose": what.face[:, 2], "expression": np.zeros((T, 10)),
        "transl": what.transl, "Ks": np.tile(camera.K, (T, 1, 1)), "w2c": np.eye(4),
    }  # fmt: skip
    tree: dict[str, Any] = {key: torch.from_numpy(np.asarray(value, np.float64)) for key, value in fields.items()}
    (folder / "smplx").mkdir(parents=True)
    torch.save(tree | {"img_wh": (camera.width, camera.height)}, folder / "smplx" / "params.pth")
    return folder


def amass(path: Path, what: Truth) -> Path:
    """One npz of SMPL-H's."""
    T = len(what.frames)
    poses = np.concatenate([what.orient, what.body.reshape(T, 63), what.hands.reshape(T, 90)], 1)
    meta = {"betas": np.zeros(16), "gender": np.array("neutral"), "mocap_framerate": np.array(120.0)}
    np.savez(path, poses=poses, trans=what.transl, dmpls=np.zeros((T, 8)), **meta)
    return path


WRITERS: dict[str, Callable[..., Path]] = {
    "smplerx": smplerx, "smplifyx": smplifyx, "easymocap": easymocap, "romp": romp, "phalp": phalp, "wham": wham,
    "gvhmr": gvhmr, "params": params,
}  # fmt: skip
SMPL = ("romp", "phalp", "wham")
"""Formats of another body than SMPL-X."""


def _ten(betas: np.ndarray) -> np.ndarray:
    return np.concatenate([betas, np.zeros(10 - len(betas))])


# --- joblib -----------------------------------------------------------------------------------------------------------


class NumpyArrayWrapper:
    """What joblib pickles in an array's place; it is written under joblib's name."""

    def __init__(self, array: np.ndarray) -> None:
        self.subclass, self.shape = np.ndarray, array.shape
        self.order = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
        self.dtype, self.allow_mmap, self.numpy_array_alignment_bytes = array.dtype, True, 16


class _Joblib(pickle._Pickler):  # type: ignore[name-defined]
    def __init__(self, stream: io.BytesIO) -> None:
        self.stream = stream
        super().__init__(stream, protocol=4)

    def save(self, value: Any, save_persistent_id: bool = True) -> None:
        if type(value) is not np.ndarray:
            super().save(value, save_persistent_id)
            return
        wrapper = NumpyArrayWrapper(value)
        super().save(wrapper)
        self.framer.commit_frame(force=True)
        padding = 16 - (self.stream.tell() + 1) % 16
        self.stream.write(bytes([padding]) + b"\xff" * padding)
        self.stream.write(value.tobytes(order=wrapper.order))


def joblib_dumps(tree: Any) -> bytes:
    """``joblib.dump`` without compression: behind its description each array lies in the stream, aligned."""
    names = {"joblib": types.ModuleType("joblib"), "joblib.numpy_pickle": types.ModuleType("joblib.numpy_pickle")}
    names["joblib.numpy_pickle"].NumpyArrayWrapper = NumpyArrayWrapper  # type: ignore[attr-defined]
    before = {name: sys.modules.get(name) for name in names}
    own = NumpyArrayWrapper.__module__
    sys.modules.update(names)
    NumpyArrayWrapper.__module__ = "joblib.numpy_pickle"
    try:
        stream = io.BytesIO()
        _Joblib(stream).dump(tree)
        return stream.getvalue()
    finally:
        NumpyArrayWrapper.__module__ = own
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
