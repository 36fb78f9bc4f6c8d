"""What a first picture of a volume shows: transfer function, lights, material, filter and view, from its voxels."""
