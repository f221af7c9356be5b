"""Normal maps of other programs: written in every convention and layout, read back, compared with the truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from soar.errors import ConfigError, InputError
from soar.perception.normal_files import CONVENTIONS
from soar.perception.normal_folder import find
from soar.perception.normals import normal_provider
from tests.conftest import conf
from tests.perception import normal_scenes as scenes

BEHIND = np.array([-1, 1, -1])  # axes of a camera that looks back at us, from ours
CROPS = [scenes.crop(frame) for frame in range(3)]


def coded(normals: np.ndarray, background: str = "clear") -> np.ndarray:
    """Unit normals as a picture (n + 1) / 2, RGBA, or RGB on a plain background."""
    inside = np.abs(normals).max(-1) > 0
    picture = np.uint8(np.round((normals + 1) / 2 * 255))
    if background == "clear":
        return np.dstack([picture, np.uint8(255 * inside)])
    return np.where(inside[..., None], picture, {"black": 0, "white": 255, "grey": 128}[background]).astype(np.uint8)


def png(path: Path, picture: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    code = cv2.COLOR_RGBA2BGRA if picture.shape[2] == 4 else cv2.COLOR_RGB2BGR
    assert cv2.imwrite(str(path), cv2.cvtColor(picture, code))


def provider(folder: Path, crops: list | None = None, **changes: object):
    node = conf("normals", "files") | changes
    return normal_provider(node, scenes.context(CROPS if crops is None else crops, {"source": folder}))


def assert_true(found: tuple[np.ndarray, np.ndarray], tolerance: float = 0.02, rim: float = 0.3) -> None:
    """Both maps are the sphere's, but for its rim, where n_z is small; a tenth of a pixel aside would be noticed."""
    for got, side in zip(found, ("front", "back"), strict=True):
        expected = scenes.truth(side)
        inner = np.abs(expected[..., 2]) > rim
        assert inner.sum() > 500
        assert np.abs(got[inner] - expected[inner]).max() < tolerance
        assert np.abs((got[inner] - expected[inner]).mean(0)[:2]).max() < 0.004
        assert not got[np.abs(expected).max(-1) == 0].any()
        inside = np.abs(got).max(-1) > 0
        np.testing.assert_allclose(np.linalg.norm(got[inside], axis=-1), 1, atol=1e-5)


def write_frames(folder: Path, change: Callable[[str, np.ndarray], np.ndarray], first: int = 0) -> None:
    """Whole frames of both sides, of every crop."""
    for frame in range(len(CROPS)):
        for side, letter in (("front", "F"), ("back", "B")):
            png(folder / f"{frame + first:06d}_normal_{letter}.png", coded(change(side, scenes.whole(side))))


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("told", [True, False])
def test_every_convention_is_read_and_found(tmp_path: Path, convention: str, told: bool) -> None:
    signs = np.array(CONVENTIONS[convention])
    write_frames(tmp_path, lambda _, normals: normals * signs)
    found = provider(tmp_path, convention=convention if told else "auto")
    assert_true(found.maps(CROPS[1]))
    (remark,) = [*found.remarks] if not told else ["the convention of " + convention]
    assert convention in remark.split("so say")[0]


def test_what_the_table_says() -> None:
    """A normal that points right, up and to the viewer, as every program writes it (docs/normals.md)."""
    ours = np.array([1.0, -1.0, -1.0])
    written = {
        "icon": (1, 1, 1), "econ": (1, 1, 1), "sapiens": (1, 1, 1), "marigold": (1, 1, 1), "metric3d": (1, -1, -1),
        "moge": (1, -1, -1), "opencv": (1, -1, -1), "dsine": (-1, 1, 1), "stablenormal": (-1, 1, 1), "nyu": (1, -1, 1),
    }  # fmt: skip
    assert {name: tuple(ours * signs) for name, signs in CONVENTIONS.items()} == written


@pytest.mark.parametrize("unknown", [(-1, 1, 1), (1, -1, 1), (-1, -1, 1), (-1, 1, -1)])
def test_signs_of_no_program_are_refused(tmp_path: Path, unknown: tuple[int, ...]) -> None:
    write_frames(tmp_path, lambda _, normals: normals * np.array(unknown))
    with pytest.raises(InputError, match=r"do not tell their convention(.*\n)*.*0 of 3"):
        provider(tmp_path)


def test_maps_that_disagree_are_refused(tmp_path: Path) -> None:
    write_frames(tmp_path, lambda _, normals: normals)
    png(tmp_path / "000001_normal_F.png", coded(scenes.whole("front") * (1, -1, -1)))
    with pytest.raises(InputError, match=r"2 of 3"):
        provider(tmp_path)
    assert provider(tmp_path, agreement=0.6).remarks


@pytest.mark.parametrize("convention", ["icon", "opencv", "dsine", "nyu"])
@pytest.mark.parametrize(("turned", "mirrored"), [(True, True), (True, False), (False, True), (False, False)])
def test_back_maps_of_a_camera_behind_are_laid_on_the_front(
    tmp_path: Path, convention: str, turned: bool, mirrored: bool
) -> None:
    signs = np.array(CONVENTIONS[convention])

    def change(side: str, normals: np.ndarray) -> np.ndarray:
        if side == "back":
            normals = normals * BEHIND if turned else normals
            normals = normals[:, ::-1] if mirrored else normals
        return normals * signs

    write_frames(tmp_path, change)
    found = provider(tmp_path, convention=convention)
    assert_true(found.maps(CROPS[0]))
    said = " ".join(found.remarks)
    assert ("turned" in said, "mirrored" in said) == (turned, mirrored)


def test_back_maps_in_no_frame_are_refused(tmp_path: Path) -> None:
    write_frames(tmp_path, lambda side, normals: normals if side == "front" else normals * (1, -1, 1))
    with pytest.raises(InputError, match="no known frame"):
        provider(tmp_path, convention="opencv")


@pytest.mark.parametrize("background", ["clear", "black", "white", "grey"])
def test_front_only_takes_the_back_of_the_body(tmp_path: Path, background: str) -> None:
    for frame in range(3):
        png(tmp_path / f"frame_{frame}.png", coded(scenes.whole("front") * (1, -1, -1), background))
    found = provider(tmp_path)
    assert_true(found.maps(CROPS[0]))
    assert any("front only" in remark for remark in found.remarks)


def written_arrays(folder: Path, layout: str) -> None:
    """Maps of whole frames as numpy arrays."""
    for frame in range(3):
        front, back = (scenes.whole(side) for side in ("front", "back"))
        if layout == "npz":
            np.savez(folder / f"{frame:04d}.npz", normal_F=front, normal_B=back)
        elif layout == "npz, compressed, channels first, in half precision":
            maps = {"front": front, "back": back}
            np.savez_compressed(
                folder / f"{frame}.npz", **{k: v.transpose(2, 0, 1).astype("f2") for k, v in maps.items()}
            )
        elif layout == "npy in two folders, with NaN where nothing is":
            for side, values in (("front", front), ("back", back)):
                (folder / side).mkdir(exist_ok=True)
                np.save(
                    folder / side / f"{frame:04d}.npy",
                    np.where(np.abs(values).max(-1, keepdims=True), values, np.nan)[None],
                )
        else:
            for side, values in (("f", front), ("b", back)):
                np.savez(folder / f"im{frame}_{side}.npz", np.int8(np.round(127 * values)))


@pytest.mark.parametrize(
    "layout",
    [
        "npz", "npz, compressed, channels first, in half precision",
        "npy in two folders, with NaN where nothing is", "npz per side, signed bytes",
    ],
)  # fmt: skip
def test_arrays(tmp_path: Path, layout: str) -> None:
    written_arrays(tmp_path, layout)
    assert_true(provider(tmp_path, convention="opencv").maps(CROPS[2]))


@pytest.mark.parametrize("scale", [0.5, 1, 2.5])
def test_whole_frames_of_other_resolutions(tmp_path: Path, scale: float) -> None:
    def change(_: str, normals: np.ndarray) -> np.ndarray:
        how = cv2.INTER_LINEAR if scale > 1 else cv2.INTER_AREA
        return cv2.resize(normals, None, fx=scale, fy=scale, interpolation=how)

    for frame in range(3):
        for side in ("front", "back"):
            np.save(tmp_path / f"{frame}_{side}.npy", change(side, scenes.whole(side)))
    assert_true(provider(tmp_path).maps(CROPS[0]), *(() if scale == 1 else (0.05, 0.5)))


def test_eight_bits_of_a_whole_frame_are_cut_exactly(tmp_path: Path) -> None:
    write_frames(tmp_path, lambda _, normals: normals)
    front, _ = provider(tmp_path).maps(CROPS[0])
    expected = scenes.truth("front")
    inner = np.abs(expected[..., 2]) > 0.1
    assert np.abs(front[inner] - expected[inner]).max() < 0.01  # half a step of 8 bits is 0.004


def test_windows_of_the_released_layout(tmp_path: Path) -> None:
    """512 x 512 RGBA in ICON's axes of a square about the person; windows.json tells where, in recorded pixels."""
    x0, y0, side, k = 82.5, 56.25, 70.0, 2.0  # the recording is twice as large as the stored frames
    scale = 512 / side
    view = scenes.VIEW
    cx, cy = ((c + at - start) * scale for c, at, start in ((view.cx, scenes.AT[0], x0), (view.cy, scenes.AT[1], y0)))
    square = scenes.Pinhole(view.fx * scale, view.fy * scale, cx, cy, 512, 512)
    for frame in range(3):
        for which, letter in (("front", "F"), ("back", "B")):
            png(tmp_path / f"normal_{letter}" / f"{frame:06d}.png", coded(scenes.truth(which, square) * (1, -1, -1)))
    box = [k * x0, k * y0, k * (x0 + side), k * (y0 + side)]
    size = [k * length for length in scenes.FRAME]
    windows = {"size": size, "windows": {f"{frame:06d}": box for frame in range(3)}}
    (tmp_path / "windows.json").write_text(json.dumps(windows))
    assert_true(provider(tmp_path).maps(CROPS[0]), 0.03, 0.5)
    del windows["windows"]["000001"]
    (tmp_path / "windows.json").write_text(json.dumps(windows))
    with pytest.raises(InputError, match=r"windows\.json for 1 of 3"):
        provider(tmp_path)


def test_numbers_that_count_from_one(tmp_path: Path) -> None:
    write_frames(tmp_path, lambda _, normals: normals, first=1)
    with pytest.raises(InputError, match=r"no front for 1 of 3 frames(.*\n)*.*000000(.*\n)*.*normals\.first_number"):
        provider(tmp_path)
    assert_true(provider(tmp_path, first_number=1).maps(CROPS[2]))


def test_folders_that_cannot_be_used(tmp_path: Path) -> None:
    picture = coded(scenes.whole("front"))

    def refused(match: str, *names: str) -> None:
        folder = tmp_path / "_".join((*match.split(), *names))
        folder.mkdir()
        for name in names:
            png(folder / name, picture)
        with pytest.raises(InputError, match=match):
            provider(folder)

    refused("no front maps")
    refused("no front maps", "0_back.png")
    refused("no frame's number", "first.png")
    refused("two front maps of frame 0", "0.png", "000000_F.png")
    refused("no back for 2 of 3", "0.png", "1.png", "2.png", "1_back.png")
    with pytest.raises(InputError, match="no folder"):
        provider(tmp_path / "nowhere")
    write_frames(tmp_path / "squeezed", lambda _, normals: normals[:, ::2])
    with pytest.raises(InputError, match=r"no map of the whole frame(.*\n)*.*windows\.json"):
        provider(tmp_path / "squeezed")


@pytest.mark.parametrize(
    "content",
    ["{", "[]", '{"size": [0, 4], "windows": {}}', '{"size": [4, 4]}',
     '{"size": [4, 4], "windows": {"a": [0, 0, 1, 1]}}',
     '{"size": [4, 4], "windows": {"0": [1, 0, 1, 1]}}', '{"size": [4, 4], "windows": {"0": [0, 0, 1]}}',
     '{"size": [4, 4], "windows": {"0": [0, 0, 1, Infinity]}}', "[" * 100000],
)  # fmt: skip
def test_malformed_windows(tmp_path: Path, content: str) -> None:
    write_frames(tmp_path, lambda _, normals: normals)
    (tmp_path / "windows.json").write_text(content)
    with pytest.raises(InputError, match="malformed"):
        provider(tmp_path)


class Bomb:
    """What a pickle runs when it is read."""

    def __reduce__(self) -> tuple:
        return (Path.touch, (Path("exploded"),))


def _npy_header(shape: str, descr: str = "'<f4'") -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("0.png", b""), ("0.png", b"not a picture, though long enough to have a size"),
        ("0.png", b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + (1 << 30).to_bytes(4, "big") * 2 + b"\x08\x02\x00\x00\x00"),
        ("0.npy", b"\x93NUMPY"), ("0.npy", _npy_header("(100000, 1000000, 3)")), ("0.npy", _npy_header("(4, 4, 3)")),
        ("0.npy", _npy_header("(4, 4, 3)") + bytes(12)), ("0.npy", _npy_header("(-4, 4, 3)")),
        ("0.npy", _npy_header("(4, 4, 3)", "__import__('os')")), ("0.npz", b"PK\x03\x04 and so on"),
    ],
)  # fmt: skip
def test_damaged_files_are_named(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=r"0\.(png|npy|npz) cannot be read"):
        provider(tmp_path, CROPS[:1])


def test_truncated_files_are_named(tmp_path: Path) -> None:
    for name, write in (
        ("0.npy", lambda path: np.save(path, scenes.whole("front"))),
        ("0.npz", lambda path: np.savez_compressed(path, front=scenes.whole("front"))),
        ("0.png", lambda path: png(path, coded(scenes.whole("front")))),
    ):
        folder = tmp_path / name[2:]
        folder.mkdir()
        write(folder / name)
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content[: len(content) // 2])
        with pytest.raises(InputError):
            provider(folder, CROPS[:1])


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_pickles_are_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    monkeypatch.chdir(tmp_path)
    bombs = np.array([Bomb()], object)
    folder = tmp_path / "maps"
    folder.mkdir()
    if suffix == ".npy":
        np.save(folder / "0.npy", bombs, allow_pickle=True)
    else:
        np.savez(folder / "0.npz", front=bombs)
    with pytest.raises(InputError, match="cannot be read"):
        provider(folder, CROPS[:1])
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize(
    "values", [np.zeros((160, 200, 3)), np.full((160, 200, 3), np.nan), np.zeros((160, 200)), np.zeros((0, 4, 3))]
)
def test_arrays_that_are_no_normals(tmp_path: Path, values: np.ndarray) -> None:
    np.save(tmp_path / "0.npy", values)
    with pytest.raises(InputError, match="no normal"):
        provider(tmp_path, CROPS[:1])


def test_settings_are_checked(tmp_path: Path) -> None:
    write_frames(tmp_path, lambda _, normals: normals)
    for changes in ({"convention": "opengl"}, {"tried": 0}, {"agreement": 0.4}):
        with pytest.raises(ConfigError):
            provider(tmp_path, **changes)
    with pytest.raises(ConfigError, match=r"normals\.source is not set"):
        normal_provider(conf("normals", "files"), scenes.context(CROPS))


def test_what_a_folder_holds(tmp_path: Path) -> None:
    write_frames(tmp_path, lambda _, normals: normals)
    assert find(tmp_path).describe() == "3 front maps, 3 back maps of 200 x 160 pixels, of whole frames"
