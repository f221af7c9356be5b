"""Estimators on images: where the person is, 137 keypoints, soft masks."""
