"""The loops that make an avatar from observations: tensors in, tensors out, resumable."""
