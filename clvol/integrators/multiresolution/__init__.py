"""The method "multiresolution": the blocks of a volume on a device, each at its own level of detail."""
