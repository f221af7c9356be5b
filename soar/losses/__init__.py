"""Differentiable terms of the objectives; every image is channel-first, every term a scalar."""
