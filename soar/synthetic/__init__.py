"""Procedural clothed people: an unlimited family of dressed, textured, posed bodies as training data."""
