"""Writes pictures as EXR, PNG, JPEG, TIFF or NPY, whole or not at all, and reads them."""

from __future__ import annotations

from clvol.image.atomic import atomic_path, atomic_paths, check_output_folder
from clvol.image.files import (
    ENDINGS,
    WITH_SCENE,
    check_output,
    is_intact,
    load_image,
    picture_texts,
    save_frame,
    save_picture,
    write_frame,
)
from clvol.image.video import VIDEO_ENDINGS, check_video, is_video, open_video

__all__ = [
    "ENDINGS", "VIDEO_ENDINGS", "WITH_SCENE", "atomic_path", "atomic_paths", "check_output", "check_output_folder",
    "check_video", "is_intact", "is_video", "load_image", "open_video", "picture_texts", "save_frame",
    "save_picture", "write_frame",
]  # fmt: skip
