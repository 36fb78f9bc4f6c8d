"""The method "raycast": samples along rays through a volume that is on the device as a whole."""
