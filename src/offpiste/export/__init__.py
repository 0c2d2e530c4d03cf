"""Models for use without Python: C and CUDA, other people's planners, ONNX."""
