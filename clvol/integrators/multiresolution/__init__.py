"""Rendering from blocks at several resolutions: what of a volume is on a device, at which level."""
