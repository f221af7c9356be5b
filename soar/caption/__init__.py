"""One sentence that says what the person of a sequence looks like: the text prompt of the generative refinement."""
