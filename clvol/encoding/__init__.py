"""Encoders of volumes: training of codebooks and assignment of codes, by OpenCL kernels (``store.codecs`` decodes)."""
