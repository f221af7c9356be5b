"""SOAR: complete, animatable surfel avatars from a video in which parts of the body are never seen."""

__version__ = "0.1.0"
