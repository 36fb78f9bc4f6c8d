"""Pictures: written whole or not at all as EXR, PNG or NPY, and read again."""

from __future__ import annotations

from clvol.image.atomic import atomic_path, check_output_folder
from clvol.image.files import ENDINGS, check_output, load_image, save_frame

__all__ = [
    "ENDINGS", "atomic_path", "check_output", "check_output_folder", "load_image", "save_frame",
]
