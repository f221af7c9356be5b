"""Assembly of the inputs, filling, mirroring."""

import numpy as np

from soar.networks.normal_inputs import INPUTS, OUTPUTS, assemble, batch, fill, mirrored, nearest_known


def picture(height=12, width=10):
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (height, width, 3), np.uint8)
    mask = np.zeros((height, width), np.uint8)
    mask[2:10, 2:8] = 255
    mask[1, 2:8] = 51
    body = np.zeros((height, width), bool)
    body[3:9, 3:6] = True
    front = np.where(body[..., None], rng.normal(size=(height, width, 3)), 0).astype(np.float32)
    return rgb, mask, front, -front, body


def test_planes_and_ranges():
    rgb, mask, front, back, body = picture()
    got = assemble(rgb, mask, front, back)
    assert {name: value.shape for name, value in got.items()} == {n: (p, 12, 10) for n, p in INPUTS.items()}
    assert all(value.dtype == np.float32 for value in got.values())
    assert np.allclose(got["image"][:, 4, 4], rgb[4, 4] / 127.5 - 1, atol=1e-6)
    assert np.allclose(got["image"][:, 1, 4], (rgb[1, 4] / 127.5 - 1) * 0.2, atol=1e-6)
    assert not got["image"][:, mask == 0].any()
    assert np.array_equal(got["body_mask"][0] > 0, body)
    assert np.allclose(got["mask"][0], mask / 255)


def test_normals_are_filled_outward_inside_the_mask_only():
    rgb, mask, front, back, body = picture()
    got = assemble(rgb, mask, front, back)
    for name, given in (("T_normal_F", front), ("T_normal_B", back)):
        plane = got[name].transpose(1, 2, 0)
        assert np.array_equal(plane[body], given[body])
        assert not plane[(mask == 0) & ~body].any()
        assert np.array_equal(plane[5, 7], given[5, 5])  # two pixels right of the body's edge
        assert np.array_equal(plane[2, 4], given[3, 4])


def test_fill_takes_the_nearest_by_brute_force():
    rng = np.random.default_rng(2)
    known = rng.uniform(size=(17, 23)) < 0.05
    values = rng.normal(size=(17, 23, 2)) * known[..., None]
    got = fill(values, nearest_known(known, np.ones_like(known)))
    where = np.argwhere(known)
    for row, column in np.ndindex(known.shape):
        distance = np.hypot(*(where - (row, column)).T)
        best = where[distance < distance.min() + 0.6]  # the transform is exact to about half a pixel
        assert any(np.array_equal(got[row, column], values[r, c]) for r, c in best)


def test_nothing_known_leaves_everything():
    rgb, mask, front, _, _ = picture()
    got = assemble(rgb, mask, front * 0, front * 0)
    assert not got["T_normal_F"].any()
    assert not got["body_mask"].any()


def test_mirroring_the_inputs_is_assembling_the_mirrored_picture():
    rgb, mask, front, back, _ = picture()
    flip = np.array([-1, 1, 1], np.float32)
    expected = assemble(rgb[:, ::-1], mask[:, ::-1], front[:, ::-1] * flip, back[:, ::-1] * flip)
    got = mirrored(assemble(rgb, mask, front, back))
    # Where two sources are equally near, left and right may differ: compare the body itself.
    for name, value in expected.items():
        keep = expected["body_mask"][0] > 0 if name.startswith("T") else np.ones((12, 10), bool)
        assert np.array_equal(got[name][:, keep], value[:, keep])


def test_mirroring_twice_changes_nothing():
    rng = np.random.default_rng(1)
    planes = {name: rng.normal(size=(2, count, 3, 5)) for name, count in (INPUTS | OUTPUTS).items()}
    once = mirrored(planes)
    assert np.array_equal(once["nml_F"][:, 0], -planes["nml_F"][:, 0, :, ::-1])
    assert np.array_equal(once["image"], planes["image"][..., ::-1])
    assert all(np.array_equal(value, planes[name]) for name, value in mirrored(once).items())


def test_batch_stacks():
    rgb, mask, front, back, _ = picture()
    one = assemble(rgb, mask, front, back)
    assert batch([one, one])["image"].shape == (2, 3, 12, 10)
