"""Multi-view diffusion models of people, behind one protocol."""
