"""What the multi-view prior is given: one assembly for training and for use.

Pictures are (3, H, W) in [-1, 1] before a grey background, which is 0: colours c as 2 c - 1, normals as they are. What
a renderer of the posed body knows of a view is its *geometry*, seven planes: the canonical coordinate ``place`` of the
surface there, the body's normal, the body's alpha (:class:`soar.synthetic.render.Maps` names the same maps).

Copying is what a small network learns last. So the colours of the condition picture are *carried* to each view here: to
every pixel those of the seen surface point that some rule calls nearest on the canonical body.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial import cKDTree

from soar.models.onnx import Signature
from soar.networks.normal_inputs import fill, nearest_known

VIEWS = 4
"""Views denoised together, 90 degrees apart."""

PLACE, NORMAL, BODY = slice(0, 3), slice(3, 6), slice(6, 7)
"""Planes of the geometry."""

RULES = 4
"""Ways to carry a colour, :func:`carried`."""

CARRIED = 3 * RULES + 1
"""Planes that :func:`carried` gives."""

DOMAIN, CONDITIONED, ALPHA_KNOWN = range(3)
"""Entries of ``flags``: 1 for normals and 0 for colours; 0 hides the condition picture; 1 if the views' ``alpha`` is
the person's and 0 if it is the body's."""


REACH = 0.11
"""How far beyond the body's outline colours are carried, as a share of the picture's side."""

CANONICAL_CENTRE = (0.0, -0.1, 0.1)
"""Middle of the cube of side 2 m that canonical coordinates are normalised by: metres on the mean shape at rest, x to
its left, y backward, z up."""

SEEN = 0.5
"""A pixel counts as the person's, or the body's, above this alpha."""


def signature(size: int) -> Signature:
    """Names and shapes of the network's tensors for pictures of ``size`` pixels; the batch is free."""
    views = (None, VIEWS)
    inputs = {
        "noisy": (*views, 3, size, size),
        "time": (None,),
        "image": (None, 3, size, size),
        "geometry": (None, VIEWS + 1, 7, size, size),
        "alpha": (None, VIEWS + 1, 1, size, size),
        "carried": (*views, CARRIED, size, size),
        "flags": (None, 3),
    }
    return Signature(inputs, {"clean": (*views, 3, size, size), "coverage": (*views, 1, size, size)})


def assemble(
    picture: np.ndarray, geometry: np.ndarray, alpha: np.ndarray, normals: bool, alpha_known: bool
) -> dict[str, np.ndarray]:
    """The network's inputs for one sample, without batch axis and without ``noisy`` and ``time``, conditioned.

    Args:
        picture: (3, H, W) condition picture, in [-1, 1] before grey.
        geometry: (5, 7, H, W) of the views and, last, of the picture.
        alpha: (5, 1, H, W) of the person.
        normals: the pictures are normal maps, not colours.
        alpha_known: tell the person's alpha of the views; else the body's stands in for it.
    """
    reach = round(REACH * alpha.shape[-1])
    flags = np.zeros(3, np.float32)
    flags[DOMAIN], flags[CONDITIONED], flags[ALPHA_KNOWN] = normals, 1, alpha_known
    return {
        "image": picture,
        "geometry": geometry,
        "alpha": alpha if alpha_known else np.concatenate([geometry[:VIEWS, BODY], alpha[VIEWS:]]),
        "carried": carried_normals(geometry[:VIEWS], reach)
        if normals
        else carried(picture, alpha[VIEWS, 0], geometry[VIEWS], geometry[:VIEWS], reach),
        "flags": flags,
    }


# A mirror through the body along its depth (y), all but forgetting depth; and the other half of the body (x).
_THROUGH = np.array([1.0, 0.12, 1.0], np.float32)
_ACROSS = np.array([-1.0, 1.0, 1.0], np.float32)
_SPREAD = 0.05  # of the mean colour, in units of place (metres on the mean shape)
_NEIGHBOURS = 12  # seen points in that mean
_FAR = 0.2  # distance at which the plane of distances ends


def carried(image: np.ndarray, seen: np.ndarray, source: np.ndarray, views: np.ndarray, reach: int) -> np.ndarray:
    """Colours of the condition picture at the surface points that each view shows.

    The rules, three planes each: the seen point behind or in front of it (nearest with depth times 0.12); the nearest
    seen point; the mean of the nearest twelve in the first metric, weighted by a Gaussian of 5 cm; the nearest to its
    mirror image across the body's plane of symmetry. Then the distance of the nearest seen point, 1 for 20 cm and more.

    Args:
        image: (3, H, W) condition picture.
        seen: (H, W) its alpha.
        source: (7, H, W) its geometry.
        views: (V, 7, H, W) geometry of the views.
        reach: pixels beyond the body's outline that receive the colours of the nearest pixel on it.

    Returns:
        (V, 13, H, W) float32, zero beyond reach, or everywhere if the picture shows nothing of the body.
    """
    out = np.zeros((len(views), CARRIED, *image.shape[1:]), np.float32)
    known = (source[BODY][0] > SEEN) & (seen > SEEN)
    if not known.any():
        return out
    places, colours = source[PLACE][:, known].T, image[:, known].T
    shown = views[:, BODY][:, 0] > SEEN
    wanted = np.moveaxis(views[:, PLACE], 1, -1)[shown]
    tree, flat = cKDTree(places), cKDTree(places * _THROUGH)
    distance, nearest = tree.query(wanted)
    away, around = flat.query(wanted * _THROUGH, k=np.arange(min(_NEIGHBOURS, len(places))) + 1)
    weight = np.exp((away[:, :1] ** 2 - away**2) / (2 * _SPREAD**2))[..., None]
    found = [
        colours[around[:, 0]],
        colours[nearest],
        (colours[around] * weight).sum(1) / weight.sum(1),
        colours[tree.query(wanted * _ACROSS)[1]],
        np.minimum(distance / _FAR, 1)[:, None],
    ]
    planes = np.zeros((*shown.shape, CARRIED), np.float32)
    planes[shown] = np.concatenate(found, 1)
    return np.stack([spread(plane, on, reach) for plane, on in zip(planes, shown, strict=True)]).transpose(0, 3, 1, 2)


def carried_normals(views: np.ndarray, reach: int) -> np.ndarray:
    """The body's own normals in place of carried colours: normals do not travel from view to view.

    Arguments and result as :func:`carried`; every rule gives the same, and the plane of distances is zero.
    """
    normals, shown = np.moveaxis(views[:, NORMAL], 1, -1), views[:, BODY][:, 0] > SEEN
    filled = [spread(plane * on[..., None], on, reach) for plane, on in zip(normals, shown, strict=True)]
    planes = np.concatenate([np.tile(filled, RULES), np.zeros((*shown.shape, 1))], -1)
    return np.ascontiguousarray(planes.transpose(0, 3, 1, 2), np.float32)


def spread(planes: np.ndarray, known: np.ndarray, reach: int) -> np.ndarray:
    """Values of known pixels, carried outward.

    Args:
        planes: (H, W, C), zero where not known.
        known: (H, W) bool.
        reach: pixels, across and down.

    Returns:
        a copy whose unknown pixels within reach of a known one hold the values of the nearest.
    """
    near = cv2.dilate(np.uint8(known), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    return fill(planes, nearest_known(known, near))
