"""[[noise]]: tiling noise that perturbs the value or the position of every sample, or what attenuates scattered light,
or makes fur."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from clvol.scene.table import AsTuple, Number, Table, Whole, wrong

LARGEST_COUNT = 4  # terms: MOST_NOISE_TERMS of cl/features.h
_Speed = Annotated[Number, Field(ge=-1e6, le=1e6)]


class Noise(Table):
    """A noise that tiles, and perturbs values, positions or the attenuation of scattered light, or makes fur.

    ``amplitude`` is in units of the value, or a world length for the target "coordinate". For "attenuation" it is added
    to the share 1 - ``shadow.scatter_color`` of the extinction that attenuates scattered light, for red, green and blue
    by a channel of the noise each, and the share stays within 0 and 1: a subtle iridescence (Engel and Ertl 2002,
    section 10).

    For "fur" the volume is full up to the value ``root``, and hairs grow from there along the gradient towards ``tip``,
    which the longest reach: the extinction is weighed by 1 - amplitude (h - n), within 0 and 1, where h is how far the
    value has gone from root to tip, and n, 0 to 1, the noise at the hair's root, as if the value changed evenly
    along the gradient, at most 32 voxel edges away (hypertexture; Perlin and Hoffert 1989). A large amplitude
    ends hairs abruptly. The transfer function must show the values where they grow. Light of associated colours stays.

    ``frequency`` is the number of tiles along the volume's longest edge. Each of ``octaves`` has twice the frequency
    and ``gain`` times the amplitude of the one before. ``velocity`` is the motion of the noise along x, y and z in
    tiles per second. Several noises add up, or their hairs thin each other out, and all are evaluated at the
    unperturbed position. A position that is moved beyond the volume shows the volume's face.
    """

    target: Literal["value", "coordinate", "attenuation", "fur"] = Field(
        title="What the noise perturbs: values, positions of samples, attenuation of scattered light; or makes: fur.",
        description="'value', 'coordinate', 'attenuation' or 'fur'",
        examples=["value"],
    )
    amplitude: Number = Field(
        ge=-1e30, le=1e30,
        title="Strength: in values, world length ('coordinate'), a share ('attenuation'); how sharp hairs end ('fur').",
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

    root: Number | None = Field(
        None,
        title="Of fur: value of the level that hairs grow from.",
        description="a finite number, for the target 'fur' alone",
        examples=[120.0],
    )
    tip: Number | None = Field(
        None,
        title="Of fur: value that the longest hairs reach.",
        description="a finite number other than root, for the target 'fur' alone",
        examples=[60.0],
    )

    @model_validator(mode="after")
    def _fur_has_ends(self) -> Noise:
        for key in ("root", "tip"):
            value = getattr(self, key)
            if (value is None) == (self.target == "fur"):
                raise wrong(key, value, "a finite number for the target 'fur', and for no other")
        if self.target == "fur" and self.root == self.tip:
            raise wrong("tip", self.tip, "another value than the root's")
        if self.target == "fur" and self.amplitude < 0:
            raise wrong("amplitude", self.amplitude, "a number that is not negative, for the target 'fur'")
        return self

    @classmethod
    def table_name(cls) -> str:
        return "noise"
