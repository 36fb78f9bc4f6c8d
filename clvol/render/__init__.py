"""Rendering scenes to pictures: ``Renderer`` and ``Frame``. The module itself is callable: ``clvol.render(x, ...)``.

``clvol.render(x, **tables)`` renders a scene, a volume, an array or a file in one call; ``help(clvol.render.render)``.
"""

import sys
from types import ModuleType
from typing import Any

from clvol.render.frame import Frame
from clvol.render.one_call import render
from clvol.render.renderer import Renderer

__all__ = ["Frame", "Renderer", "render"]


class _CallableModule(ModuleType):
    """Makes ``clvol.render(...)`` a call, whichever of its modules was imported first."""

    def __call__(self, x: Any, **keys: Any) -> Frame:
        return render(x, **keys)


sys.modules[__name__].__class__ = _CallableModule
