"""Rendering: one module a method, each beside its reference."""

from clvol.render.frame import Frame
from clvol.render.renderer import Renderer

__all__ = ["Frame", "Renderer"]
