"""Other people taken out of the subject's mask, whoever made it.

Networks that segment a person take everybody who touches for one. Where somebody else comes near the subject, a graph
cut (GrabCut, Rother et al. 2004) divides the mask by colour. The colours of both are learned from frames of the same
clip in which they stand apart, and are not adapted to the frame that is divided. Pixels go only where they belong
together with some that the pose network counts to the other person; where that person is hidden, and nobody can tell
where they show, they go wherever their colours do, and with them the rim of the mask.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from soar.body.openpose import BODY
from soar.perception.keypoints import Frames, Keypoints
from soar.perception.masks import keep_touching, paste, skeleton, support
from soar.perception.pose import PoseNetwork
from soar.perception.roi import Roi

_LESSONS, _TRIES = 8, 24  # frames to learn the colours from, and at most to look through for them
_SAMPLES, _FEWEST = 5000, 100  # pixels of either side to learn from, and fewest in a frame that is of use
_APART = 0.03  # sides of the region between two people who stand apart
_RIM = 1 / 256  # sides of the region by which a border between two people may be off: a cell of the network's mask
_BONE, _MIN_CONFIDENCE = 0.01, 0.1  # width of a bone in sides of the region, and confidence of its ends
_NOWHERE = (0, 0, 0, 0)  # the rectangle of GrabCut, which labels stand in for
_MIXTURE = 65  # numbers of a mixture of five Gaussians, as OpenCV has it


def _disc(radius: int) -> np.ndarray:
    return np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)


class Apart:
    """Removes other people from the masks of one clip.

    Args:
        frames: the clip.
        record: the subject, and who is near them.
        pose: the network that tells the people's pixels.

    Attributes:
        learned: whether there were frames to learn the colours from; without, masks are left as they are.
    """

    def __init__(self, frames: Frames, record: Keypoints, pose: PoseNetwork) -> None:
        self._record, self._pose, self._company = record, pose, record.company
        self._others, self._subject = np.zeros((2, 1, _MIXTURE))
        lessons = list(self._lessons(frames))
        self.learned = bool(lessons)
        if lessons:
            self._learn(*(np.concatenate(side) for side in zip(*lessons, strict=True)))

    def __call__(self, t: int, image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """The mask without other people.

        Args:
            t: index of the frame.
            image: (H, W, 3) uint8 RGB frame.
            alpha: (H, W) float32 in [0, 1].
        """
        if not (self.learned and self._company[t] and alpha.any()):
            return alpha
        rim = max(1, round(float(self._record.roi[t, 2]) * _RIM))
        window = support(alpha, 4 * rim)
        mask, seen = alpha[window], image[window]
        label = np.where(mask > 0.1, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
        models = self._others.copy(), self._subject.copy()
        cv2.grabCut(np.ascontiguousarray(seen), label, _NOWHERE, *models, 1, cv2.GC_EVAL_FREEZE_MODEL)
        foreign = label != cv2.GC_PR_FGD
        gone = cv2.morphologyEx(((mask > 0.5) & foreign).astype(np.uint8), cv2.MORPH_OPEN, _disc(rim))
        people = self._record.others[t]
        hidden = bool(((people[:, 2] > 0) & (people[:, 4] == 0)).any())
        if not hidden:
            gone = _touching(gone, cv2.dilate(self._claimed(t, image)[window], _disc(2 * rim)))
        if not (hidden or gone.any()):
            return alpha
        soft = foreign & (mask <= 0.5) & (cv2.dilate(gone, _disc(4 * rim)) > 0)
        kept = np.where(soft | (cv2.dilate(gone, _disc(rim)) > 0), np.float32(0), mask)
        if hidden:
            kept = cv2.erode(kept, _disc(rim))
        result = np.zeros_like(alpha)
        result[window] = kept
        side = float(self._record.roi[t, 2])
        body = self._record.keypoints[t, : len(BODY)]
        bones = skeleton(body, alpha.shape, _MIN_CONFIDENCE, round(side * _BONE))
        return keep_touching(result, bones, 4 * rim)

    def _mask(self, image: np.ndarray, roi: Roi) -> np.ndarray:
        """(H, W) uint8: 1 on the pixels of the person in a region."""
        rect = (0, 0, image.shape[1], image.shape[0])
        return (paste(self._pose(image, roi).mask, roi, False, rect) > 0.5).astype(np.uint8)

    def _claimed(self, t: int, image: np.ndarray) -> np.ndarray:
        """(H, W) uint8: 1 on the pixels of the other people that are seen in a frame."""
        claimed = np.zeros(image.shape[:2], np.uint8)
        for cx, cy, side, rotation, seen in self._record.others[t].tolist():
            if side > 0 and seen:
                claimed |= self._mask(image, Roi(cx, cy, side, rotation))
        return claimed

    def _lessons(self, frames: Frames) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Pixels (N, 3) of the subject and (M, 3) of others, of frames in which all are seen apart."""
        record = self._record
        known = (record.others[..., 2] == 0) | (record.others[..., 4] > 0)
        usable = np.flatnonzero(record.present & self._company & known.all(1))
        found = 0
        for t in sorted(usable.tolist(), key=self._closeness)[:_TRIES]:
            image = frames[t]
            own, other = self._mask(image, Roi(*record.roi[t].tolist())), self._claimed(t, image)
            margin = max(1, round(float(record.roi[t, 2]) * _APART))
            apart = not (cv2.dilate(own, _disc(margin)) & other).any()
            if apart and min(own.sum(), other.sum()) >= _FEWEST:
                yield image[own > 0], image[other > 0]
                found += 1
            if found == _LESSONS:
                return

    def _closeness(self, t: int) -> float:
        own = Roi(*self._record.roi[t].tolist())
        return max(own.overlap(Roi(*row[:4].tolist())) for row in self._record.others[t] if row[2] > 0)

    def _learn(self, own: np.ndarray, other: np.ndarray) -> None:
        """Fit a mixture of Gaussians to the colours of either side: GrabCut's own, to a strip of labelled pixels."""
        rng = np.random.default_rng(0)
        own, other = (rng.permutation(pixels)[:_SAMPLES] for pixels in (own, other))
        strip = np.concatenate([own, other])[None]
        label = np.repeat([cv2.GC_FGD, cv2.GC_BGD], [len(own), len(other)]).astype(np.uint8)[None]
        cv2.setRNGSeed(0)  # of the clustering
        cv2.grabCut(strip, label, _NOWHERE, self._others, self._subject, 1, cv2.GC_INIT_WITH_MASK)


def _touching(mask: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The components of ``mask`` (H, W) uint8 that reach into ``other`` (H, W)."""
    _, labels = cv2.connectedComponents(mask, connectivity=8)
    wanted = np.unique(labels[(other > 0) & (mask > 0)])
    return np.isin(labels, wanted[wanted > 0]).astype(np.uint8)
