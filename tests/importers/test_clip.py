"""The one person of a clip out of an archive: who, in which frames, and what lies between."""

import dataclasses
import itertools

import numpy as np
import pytest

from soar.body.observations import Observations
from soar.body.openpose import BODY, COUNT, INDEX
from soar.body.parameters import SmplxParameters, in_world
from soar.errors import InputError
from soar.importers.archive import Archive
from soar.importers.clip import Clip, ClipSettings, interpolated, subject_in
from tests.importers import person
from tests.importers.test_parameters import MODEL, parameters

CAMERA = person.camera(T=person.elsewhere())
OPTIONS = ClipSettings(reach=0.5, longest_gap=3)


def observed(what: person.Truth, unseen: tuple[int, ...] = ()) -> Observations:
    """Perfect keypoints of the joints that are hips, shoulders and such."""
    joints = person.joints_of(MODEL, what)
    points = np.zeros((len(joints), COUNT, 3))
    for row, column in zip(MODEL.keypoint_rows.tolist(), MODEL.keypoint_columns.tolist(), strict=True):
        local = joints[:, column - len(MODEL.v_template)]
        p = local @ CAMERA.K.T
        points[:, row] = np.concatenate([p[:, :2] / p[:, 2:], np.ones((len(p), 1))], 1)
    points[list(unseen), :, 2] = 0
    return Observations.gather([CAMERA], [points], [np.zeros((len(points), len(BODY), 3))], 0.3)


def found(archive: Archive, what: person.Truth, options: ClipSettings = OPTIONS, ids: range | None = None) -> Clip:
    return subject_in(archive, ids or range(len(what.frames)), observed(what), MODEL, options)


def only(given: SmplxParameters, rows: list[int]) -> SmplxParameters:
    per_frame = {
        f.name: getattr(given, f.name)[rows]
        for f in dataclasses.fields(given)
        if isinstance(getattr(given, f.name), np.ndarray)
    }
    return dataclasses.replace(given, **per_frame)


def test_the_subject_is_followed_through_lists_that_change_their_order() -> None:
    what, other = person.truth(), person.truth(aside=1.2, seed=4)
    a, b = parameters(what, CAMERA), parameters(other, CAMERA)
    rows = np.array([0, 1, 0, 1, 0])
    mixed = []
    for first in (a, b), (b, a):
        values = {
            name: np.stack([getattr(first[i], name)[t] for t, i in enumerate(rows)])
            for name in ("global_orient", "body_pose", "translation", "betas", "left_hand", "right_hand", "face")
        }
        mixed.append(dataclasses.replace(a, **values))
    clip = found(Archive(tuple(mixed)), what)
    expected = in_world(a, MODEL, CAMERA)
    np.testing.assert_allclose(clip.parameters.body_pose, expected.body_pose, atol=1e-9)
    np.testing.assert_allclose(clip.parameters.pelvis(MODEL), expected.pelvis(MODEL), atol=1e-9)
    assert not clip.interpolated.any()
    assert any("2 people" in remark for remark in clip.remarks)


def test_frames_are_counted_as_the_archive_counts() -> None:
    """A clip that is a part of the recording, every second frame of it, in an archive that counts from 1."""
    what = person.truth(20)
    whole = dataclasses.replace(parameters(what, CAMERA), frames=np.arange(1, 21))
    ids = range(4, 16, 2)
    part = person.Truth(**{f.name: getattr(what, f.name) for f in dataclasses.fields(what)} | {
        name: getattr(what, name)[list(ids)] for name in ("frames", "orient", "body", "hands", "face", "transl")
    })  # fmt: skip
    clip = found(Archive((whole,), first=1), part, ids=ids)
    np.testing.assert_allclose(clip.parameters.body_pose, part.body)
    assert clip.parameters.frames.tolist() == list(ids)
    assert "14 are beyond the clip" in clip.remarks[0]
    with pytest.raises(InputError, match="other frames") as caught:
        found(Archive((whole,), first=200), part, ids=ids)
    assert "body.first_frame" in str(caught.value)
    assert "1 to 20" in str(caught.value)


def test_gaps_are_interpolated_and_told() -> None:
    what = person.truth(7)
    clip = found(Archive((only(parameters(what, CAMERA), [1, 2, 5]),)), what)
    assert np.flatnonzero(clip.interpolated).tolist() == [0, 3, 4, 6]
    expected = in_world(parameters(what, CAMERA), MODEL, CAMERA)
    np.testing.assert_allclose(clip.parameters.body_pose[[0, 6]], expected.body_pose[[1, 5]], atol=1e-9)
    third = expected.translation[2] * 2 / 3 + expected.translation[5] / 3
    np.testing.assert_allclose(clip.parameters.translation[3], third + 0 * third, atol=0.05)
    assert "4 frames of the clip are interpolated" in clip.remarks[1]
    with pytest.raises(InputError, match="more than 1 frames in a row") as caught:
        found(Archive((only(parameters(what, CAMERA), [1, 2, 5]),)), what, dataclasses.replace(OPTIONS, longest_gap=1))
    assert "body.longest_gap" in str(caught.value)


def test_joints_turn_at_a_constant_rate_through_a_gap() -> None:
    given = only(in_world(parameters(person.truth(), CAMERA), MODEL, CAMERA), [0, 1])
    a, b = np.array([2.9, 0.2, 0.1]), np.array([-2.9, 0.1, 0.3])  # apart by half a radian, but for their coordinates
    given = dataclasses.replace(given, frames=np.array([0, 4]), global_orient=np.stack([a, b]))
    between, missing = interpolated(given, np.arange(5), 3)
    assert missing.tolist() == [False, True, True, True, False]
    R = [person.rotation(v) for v in between.global_orient]
    steps = [person.rotation_vector(x.T @ y) for x, y in itertools.pairwise(R)]
    np.testing.assert_allclose(steps, np.tile(steps[0], (4, 1)), atol=1e-9)
    np.testing.assert_allclose(R[4], person.rotation(b), atol=1e-9)
    assert np.linalg.norm(steps[0]) < 0.2


def test_somebody_elsewhere_is_nobody() -> None:
    what, other = person.truth(), person.truth(aside=1.5)
    a = parameters(what, CAMERA)
    away = dataclasses.replace(a, translation=np.concatenate([what.transl[:3], other.transl[3:]]))
    clip = found(Archive((away,)), what)
    assert "2 hold other people only" in clip.remarks[1]
    with pytest.raises(InputError, match="nobody in the body parameters is where") as caught:
        found(Archive((dataclasses.replace(a, translation=other.transl),)), what)
    assert "body.reach" in str(caught.value)


def test_the_subject_is_looked_for_where_it_was_while_unseen() -> None:
    what, other = person.truth(), person.truth(aside=1.2)
    people = Archive(tuple(parameters(who, CAMERA) for who in (other, what)))
    clip = subject_in(people, range(5), observed(what, unseen=(0, 2, 3)), MODEL, OPTIONS)
    expected = in_world(parameters(what, CAMERA), MODEL, CAMERA)
    np.testing.assert_allclose(clip.parameters.translation, expected.translation, atol=1e-9)
    hips = observed(what)
    hips.confidence[:, :, INDEX["left_hip"]] = 0
    with pytest.raises(InputError, match="hips of the subject are never seen"):
        subject_in(people, range(5), hips, MODEL, OPTIONS)


def test_shapes_that_are_not_used_are_told() -> None:
    what = person.truth()
    a = parameters(what, CAMERA)
    clip = found(Archive((dataclasses.replace(a, betas=None),)), what)
    assert any("another body's" in remark for remark in clip.remarks)
    long = dataclasses.replace(a, betas=np.concatenate([a.betas, np.ones((5, 6))], 1))
    assert any("first 4 of their 10 betas" in remark for remark in found(Archive((long,)), what).remarks)
    assert len(found(Archive((a,)), what).remarks) == 1


def test_people_of_different_bodies_are_refused() -> None:
    a = parameters(person.truth(), CAMERA)
    with pytest.raises(InputError, match="different bodies"):
        Archive((a, dataclasses.replace(a, betas=None)))
    with pytest.raises(InputError, match="different bodies"):
        Archive((a, dataclasses.replace(a, betas=np.ones((5, 16)))))
