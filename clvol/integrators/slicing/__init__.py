"""The integrator "slicing": slices of the volume drawn one over the other."""
