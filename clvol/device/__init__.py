"""Scenes on a device, for every integrator: voxels, tables, empty space, gradients, lights, effects."""
