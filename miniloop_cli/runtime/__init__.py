"""Cache, files, processes, kernels."""
