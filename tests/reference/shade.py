"""Blinn-Phong with lights and an environment."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from clvol.image import load_image


def lights_that_shine(resolved) -> list:
    """(number, light) of the lights that are not black, nor spots whose cone is 0."""
    return [
        (k, light) for k, light in enumerate(resolved.lights)
        if light.intensity > 0 and np.any(np.asarray(light.color) > 0)
        and not (light.type == "spot" and light.cone_degrees == 0)
    ]  # fmt: skip


class Shader:
    """The lit colour of samples and surfaces. ``shadows``: a ``shadow.Shadows``, ``occlusion``: an
    ``occlusion.Occlusion``, or None."""

    def __init__(self, resolved, environment, shadows, occlusion=None) -> None:
        self.material = resolved.material
        self.lights = lights_that_shine(resolved)
        self.environment = environment
        self.shadows = shadows
        self.occlusion = occlusion

    @property
    def lights_anything(self) -> bool:
        return bool(self.lights) or self.environment is not None

    def lit(
        self, color, at, gradient, direction, *, weight=None, cut_normal=None, cut_share=None,
        surface=None,
    ) -> np.ndarray:  # fmt: skip
        """``color`` [n, 3] lit at world positions ``at`` for a viewer along -``direction``.

        ``weight`` [n]: opacity times remaining transmittance, which decides whether a shadow ray is
        cast. ``cut_normal`` [n, 3] outwards, ``cut_share`` [n]: how much a cut face's normal counts
        instead of the gradient's. ``surface`` int [n]: the iso-surface that the place lies on.
        """
        if not self.lights_anything:
            return self._without_light(color, at, gradient, surface)
        slope = np.linalg.norm(gradient, axis=1)
        known = np.isfinite(slope) & (slope > 0)
        strength = known.astype(float)
        fade = self.material.fade
        if fade > 0:
            strength = np.where(known, np.minimum(np.where(known, slope, 0) / fade, 1.0), 0.0)
        gradient = np.where(known[:, None], gradient, 0.0)
        normal = -gradient / np.where(known, slope, 1.0)[:, None]
        view = -direction
        if cut_share is not None:
            at_cut = cut_share > 0
            turned = self.material.two_sided & (np.sum(normal * cut_normal, axis=1) < 0)
            normal = np.where((at_cut & turned)[:, None], -normal, normal)
            normal = cut_share[:, None] * cut_normal + (1.0 - cut_share)[:, None] * normal
            length = np.linalg.norm(normal, axis=1)
            normal = normal / np.where(length > 0, length, 1.0)[:, None]
            if fade == 0:
                strength = np.where(at_cut, length > 0, strength)
        if self.material.two_sided:
            normal = np.where((np.sum(normal * view, axis=1) < 0)[:, None], -normal, normal)
        shown = strength > 0
        unlit = color if self.occlusion is None else color * self.occlusion.share(at)[:, None]
        out = unlit.copy()
        if shown.any():
            lit = self._reflected(
                color[shown], at[shown], normal[shown], gradient[shown], view[shown],
                None if weight is None else weight[shown],
                None if surface is None else surface[shown],
            )  # fmt: skip
            share = strength[shown, None]
            out[shown] = (1.0 - share) * unlit[shown] + share * lit
        return out

    def _without_light(self, color, at, gradient, surface):
        """Colours of a scene without lights."""
        if self.occlusion is None:
            return color
        share = self.occlusion.share(at)
        slope = np.linalg.norm(gradient, axis=1)
        known = np.isfinite(slope) & (slope > 0)
        if surface is not None and known.any():
            normal = -gradient[known] / slope[known, None]
            share[known] = self.occlusion.share(at[known], normal, True)
        return color * share[:, None]

    def _reflected(self, color, at, normal, gradient, view, weight, surface):
        m = self.material
        light_diffuse, highlight = np.zeros_like(color), np.zeros_like(color)
        facing = np.sum(normal * view, axis=1) >= 0
        for number, light in self.lights:
            to_light, distance = toward(light, at, view)
            cosine = np.sum(normal * to_light, axis=1)
            reached = facing & (cosine > 0)
            half = to_light + view
            length = np.linalg.norm(half, axis=1)
            half = half / np.where(length > 0, length, 1.0)[:, None]
            shine = np.maximum(np.sum(normal * half, axis=1), 0.0) ** m.shininess
            color_in = np.asarray(light.color, float) * light.intensity * aimed(light, -to_light)
            shadow = np.ones_like(color)
            if self.shadows is not None and light.type != "headlight" and light.casts_shadow:
                shadow = self.shadows.transmittance(
                    number, at, to_light, distance, weight, surface, gradient
                )
            arriving = shadow * color_in
            light_diffuse += np.where(reached, cosine, 0.0)[:, None] * arriving
            highlight += np.where(reached, shine, 0.0)[:, None] * arriving
        ambient, seen = 1.0, 1.0
        if self.occlusion is not None:
            left = self.occlusion.share(at, normal, surface is not None)[:, None]
            ambient, seen = (left, 1.0) if self.occlusion.settings.darkens == "ambient" else (1.0, left)
        lit = color * (m.ambient * ambient + m.diffuse * light_diffuse) + m.specular * highlight
        if self.environment is not None:
            reflected = 2.0 * np.sum(normal * view, axis=1)[:, None] * normal - view
            lit += color * m.diffuse * ambient * self.environment.diffuse(normal)
            lit += m.specular * self.environment.specular(reflected, m.shininess)
        return seen * lit


def aimed(light, along: np.ndarray) -> np.ndarray:
    """[n, 3] or 1: the share of a spot's or image's light that goes ``along`` [n, 3] (0 at the light itself)."""
    if light.type not in ("spot", "image"):
        return np.ones(1)
    forward = np.asarray(light.direction, float) / np.linalg.norm(light.direction)
    ahead = along @ forward
    if light.type == "spot":
        outer = np.radians(light.cone_degrees)
        inner = outer * (1.0 - light.penumbra)
        if outer == inner:
            return np.broadcast_to((ahead > np.cos(outer))[:, None], along.shape).astype(float)
        t = np.clip((ahead - np.cos(outer)) / (np.cos(inner) - np.cos(outer)), 0.0, 1.0)
        return np.broadcast_to((t * t * (3.0 - 2.0 * t))[:, None], along.shape)
    texels = load_image(light.file)["rgba"][..., :3].astype(float)
    height, width = texels.shape[:2]
    right = np.cross(forward, np.asarray(light.up, float))
    right /= np.linalg.norm(right)
    half = np.tan(np.radians(light.fov_degrees) / 2)
    ahead = np.where(ahead > 0, ahead, np.nan)
    u, v = along @ right / ahead / (half * width / height), -(along @ np.cross(right, forward)) / ahead / half
    on = (np.abs(u) <= 1) & (np.abs(v) <= 1)
    x = np.clip((np.where(on, u, 0) + 1) / 2 * width - 0.5, 0, width - 1)
    y = np.clip((np.where(on, v, 0) + 1) / 2 * height - 0.5, 0, height - 1)
    values = [map_coordinates(texels[..., k], [y, x], order=1, mode="nearest") for k in range(3)]
    return np.where(on[:, None], np.stack(values, axis=1), 0.0)


def toward(light, at: np.ndarray, view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(unit vectors to ``light`` [n, 3], world distances to it [n]) from ``at`` [n, 3]."""
    far = np.full(len(at), np.inf)
    if light.type == "headlight":
        return view, far
    if light.type == "directional":
        to = -np.asarray(light.direction, float)
        return np.broadcast_to(to / np.linalg.norm(to), at.shape), far
    offset = np.asarray(light.position, float) - at
    distance = np.linalg.norm(offset, axis=1)
    return offset / np.where(distance > 0, distance, 1.0)[:, None], distance
