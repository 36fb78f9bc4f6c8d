"""[[noise]]: tiling noise that perturbs the value or the position of every sample, or what attenuates scattered light.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from clvol.scene.table import AsTuple, Number, Table, Whole

LARGEST_COUNT = 4  # terms: MOST_NOISE_TERMS of cl/features.h
_Speed = Annotated[Number, Field(ge=-1e6, le=1e6)]


class Noise(Table):
    """A noise that tiles, and perturbs values, positions or the attenuation of scattered light.

    ``amplitude`` is in units of the value, or a world length for the target "coordinate". For "attenuation" it is added
    to the share 1 - ``shadow.scatter_color`` of the extinction that attenuates scattered light, for red, green and blue
    by a channel of the noise each, and the share stays within 0 and 1: a subtle iridescence (Engel and Ertl 2002,
    section 10). ``frequency`` is the number
    of tiles along the volume's longest edge. Each of ``octaves`` has twice the frequency and ``gain`` times the
    amplitude of the one before. ``velocity`` is the motion of the noise along x, y and z in tiles per second. Several
    noises add up, and all are evaluated at the unperturbed position. A position that is moved beyond the volume shows
    the volume's face.
    """

    target: Literal["value", "coordinate", "attenuation"] = Field(
        title="What the noise perturbs: values, the positions of samples, or the attenuation of scattered light.",
        description="'value', 'coordinate' or 'attenuation'",
        examples=["value"],
    )
    amplitude: Number = Field(
        ge=-1e30, le=1e30,
        title="Strength, in units of the value or of world length ('coordinate'), or a share ('attenuation').",
        description="a number from -1e30 to 1e30",
        examples=[30.0],
    )
    frequency: Number = Field(
        4.0, gt=0, le=1e4,
        title="Number of noise tiles along the longest edge of the volume.",
        description="a number greater than 0, at most 10000",
    )
    octaves: Whole = Field(
        1, ge=1, le=8,
        title="Number of octaves, each of twice the frequency of the one before.",
        description="a whole number from 1 to 8",
    )
    gain: Number = Field(
        0.5, ge=0, le=1,
        title="Amplitude of an octave relative to the one before.",
        description="a number from 0 to 1",
    )
    seed: Whole = Field(
        0, ge=0, le=2**31 - 1,
        title="Seed of the noise.",
        description="a whole number from 0 to 2147483647",
    )
    velocity: Annotated[tuple[_Speed, _Speed, _Speed], AsTuple] = Field(
        (0.0, 0.0, 0.0),
        title="Motion of the noise along x, y and z, in tiles per second.",
        description="three numbers [x, y, z] from -1e6 to 1e6",
    )

    @classmethod
    def table_name(cls) -> str:
        return "noise"
