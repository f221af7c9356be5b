"""Rotations, cameras and meshes: the mathematics that every floor above shares."""
