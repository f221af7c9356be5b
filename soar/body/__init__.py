"""The parametric body: its record, posing, keypoints, camera refinement and the fit to images.

Needs :mod:`soar.geometry` and :mod:`soar.raster`; knows nothing of networks, files of the workflow or avatars.
"""
