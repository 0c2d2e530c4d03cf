"""Export of trained models to C, CUDA, MPPI-Generic and ONNX."""
