"""Steps of a series in several processes: each gets the step that is shown, and what is known over all times."""

from __future__ import annotations

from clvol.integrators.raycast.step_map import known_cells, remember_cells
from clvol.render.isolation.channel import Message
from clvol.render.isolation.scene_message import decoded, encoded
from clvol.volume.axis import ValueAxis
from clvol.volume.series import SeriesFacts, StepVolume, VolumeSeries
from clvol.volume.series_steps import Step
from clvol.volume.volume import Census, Volume


def step_facts(volume: StepVolume, known: list[VolumeSeries]) -> Message:
    """What ``step_of`` takes. ``known``: the series so far, whose places are their numbers; a new one is added."""
    series, facts = volume.series, volume.series.facts
    place = next((k for k, each in enumerate(known) if each is series), len(known))
    if place == len(known):
        known.append(series)
    census = facts.census
    return {
        "series": place, "count": len(series), "number": volume.number, "plain": volume.axis.is_plain,
        "widest": facts.widest, "census": [census.lower, census.upper, census.nans, census.infs],
        "axis": encoded(facts.axis), "cells": encoded(known_cells(volume.widest)),
    }  # fmt: skip


def step_of(volume: Volume, facts: Message, known: dict[int, VolumeSeries]) -> StepVolume:
    """The step that ``step_facts`` describes, with the voxels of ``volume``."""
    place = facts["series"]
    if place not in known:
        steps = [Step(f"step {k}", _not_here) for k in range(facts["count"])]
        axis: ValueAxis = decoded(facts["axis"])
        known[place] = VolumeSeries.of_facts(steps, SeriesFacts(
            volume.grid, volume.dtype, axis, Census(*facts["census"]), facts["widest"], volume.frame, volume.unit,
            volume.labels,
        ), volume.name)  # fmt: skip
    series = known[place]
    series.show(facts["number"], volume)
    step = series.view(facts["number"], facts["plain"])
    cells = decoded(facts["cells"])
    if cells is not None:
        remember_cells(step.widest, cells)
    return step


def _not_here() -> Volume:
    raise AssertionError("the voxels of another step than the one that is shown")
