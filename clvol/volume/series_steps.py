"""The steps of a series: what is read for each, from files, functions, arrays and objects of other libraries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.array_axes import Axis

if TYPE_CHECKING:
    from clvol.volume.series_checks import StepRange
    from clvol.volume.volume import Volume


@dataclass(frozen=True, eq=False)
class Step:
    """One step. ``read()`` returns its volume, or raises VolumeError. ``name`` is for messages, and is unique where
    that is possible; ``spellings``: names by which it can be selected. ``may_convert``: its type may differ from that
    of other steps, since it depends on values. ``known()`` returns the volume without voxels, and its range, if they
    are known without reading; ``remember(volume, range)`` keeps them for later."""

    name: str
    read: Callable[[], Volume]
    path: str | None = None
    spellings: tuple[str, ...] = ()
    may_convert: bool = False
    known: Callable[[], tuple[Volume, StepRange] | None] | None = None
    remember: Callable[[Volume, StepRange], None] | None = None


def steps_of(steps: Any, made: Callable[[Any], Volume], names: Sequence[str] | None) -> list[Step]:
    """The steps of what a caller passes as a series. ``made(array)``: the volume of one of them."""
    if hasattr(steps, "dims") and hasattr(steps, "isel"):
        parts = _of_xarray(steps)
    elif isinstance(steps, np.ndarray) or (hasattr(steps, "ndim") and hasattr(steps, "__getitem__")):
        if steps.ndim != 4:
            raise VolumeError("series", f"a {steps.ndim}-D array", "a 4-D array [t, z, y, x], or a list of volumes")
        parts = [partial(steps.__getitem__, k) for k in range(steps.shape[0])]
    elif isinstance(steps, (list, tuple)):
        parts = [each if callable(each) else partial(_itself, each) for each in steps]
    else:
        expected = "a list of volumes or functions, a 4-D array [t, z, y, x], or a DataArray with a dimension of time"
        raise VolumeError("series", f"a {type(steps).__name__}", expected)
    if names is not None and len(names) != len(parts):
        raise VolumeError("series", f"{len(names)} names for {len(parts)} steps", "a name for each step")
    said = [f"step {k}" for k in range(len(parts))] if names is None else [str(name) for name in names]
    return [
        Step(name, partial(_made, name, part, made), spellings=(name,)) for name, part in zip(said, parts)
    ]  # fmt: skip


def _itself(value: Any) -> Any:
    return value


def _made(name: str, part: Callable[[], Any], made: Callable[[Any], Volume]) -> Volume:
    try:
        return made(part())
    except VolumeError as error:
        own = error.where in ("volume", name)
        raise VolumeError(name, error.what if own else f"{error.where}: {error.what}", error.expected) from error
    except MemoryError as error:
        raise VolumeError(name, "the volume does not fit into memory") from error
    except OSError as error:
        raise VolumeError(name, error.strerror or str(error), "a step that can be read") from error


def _of_xarray(value: Any) -> list[Callable[[], Any]]:
    """A part of a DataArray for each time."""
    times = [dim for dim in value.dims if Axis(str(dim)).kind == "t"]
    if len(times) != 1:
        dims = ", ".join(map(str, value.dims))
        raise VolumeError("series", f"an array of the dimensions {dims}", "one dimension of time, called 'time' or 't'")
    dim = times[0]
    return [partial(value.isel, {dim: k}) for k in range(value.sizes[dim])]
