"""Training of this project's own networks on synthetic people."""
