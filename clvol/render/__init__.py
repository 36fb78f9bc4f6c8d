"""Rendering scenes to pictures: ``Renderer`` and ``Frame``."""

from clvol.render.frame import Frame
from clvol.render.renderer import Renderer

__all__ = ["Frame", "Renderer"]
