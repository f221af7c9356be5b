"""Small convolutional networks of this project's own, trained on synthetic people, and their export to ONNX."""
