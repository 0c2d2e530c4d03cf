"""Textures and shading of the ground in batches, against a plain reference of one place."""

import numpy as np
import pytest

from offpiste.simulation.rendering import shading as s
from offpiste.simulation.rendering.appearance import draw_light
from offpiste.simulation.rendering.shading import WAVELENGTHS, octave_turns, pebbles, random_lattice, value_noise

OCTAVES = len(WAVELENGTHS)


def one_place(lattice, turn, sun, x, y, finest):
    """The plain reference: octaves of one place, one after the other."""
    value, slope = np.zeros(OCTAVES), np.zeros(OCTAVES)
    for o, (cos, sin) in enumerate(turn.astype(float)):
        fade = min(finest / np.hypot(cos, sin) - 1, 1)
        if fade > 0:
            result, slope_x, slope_y = value_noise.py_func(
                lattice, cos * x + sin * y + o * 17, cos * y - sin * x + o * 29
            )
            value[o], slope[o] = fade * result, -fade * (slope_x * sun[o, 0] + slope_y * sun[o, 1])
    return value, slope


PIXEL = 1 / 530.0


def one_ground(ground, light, x, y, facing, phase, footprint, shadow, distance):
    """The plain reference: colour of one place on the ground, and which details it shows."""
    n, slope = one_place(ground.lattice, ground.turn, ground.sun, x, y, 0.5 / footprint)
    wander_x, wander_y = n[6] + 0.5 * n[4], n[5] - 0.5 * n[3]
    c = np.empty(s.CHANNELS)
    s.read_nodes.py_func(ground, x + s.RAGGED * wander_x, y + s.RAGGED * wander_y, c)

    hue = np.clip(0.5 + 0.35 * (n[9] - n[8] + n[7] - n[6] + n[5]), 0, 1)
    colour = (c[s.LOW : s.LOW + 3] + hue * (c[s.HIGH : s.HIGH + 3] - c[s.LOW : s.LOW + 3])) ** 2
    middle = n[3:6].sum()
    tone = s.MOST_RELIEF * (c[s.FINE] * (n[:3].sum() + 0.5 * middle) + c[s.COARSE] * (n[6:].sum() + 0.5 * middle))
    relief = s.MOST_RELIEF * c[s.BUMPS] * slope[:6].sum()
    details = set()
    if c[s.STONES] > 0.02 and footprint < s.STONE_SIZE / 2:
        details.add("stones")
        sharp = min(s.STONE_SIZE / (2 * footprint) - 1, 1.0)
        stone = pebbles.py_func(ground.lattice, x / s.STONE_SIZE + 0.25 * n[2], y / s.STONE_SIZE + 0.25 * n[1])
        tone += c[s.STONES] * sharp * stone
    if c[s.BLADES] > 0.02:
        details.add("grass")
        colour += np.exp(-3 * c[s.BLADES] / facing) * (ground.soil - colour)
        if footprint < 2 * s.BLADE_WIDTH:
            details.add("blades")
            sharp = min(2 * s.BLADE_WIDTH / footprint - 1, 1.0)
            cos, sin = np.cos(3.0 * n[8] + 1.5 * n[6]), np.sin(3.0 * n[8] + 1.5 * n[6])
            across, along = (cos * x + sin * y) / s.BLADE_WIDTH, (cos * y - sin * x) / s.BLADE_LENGTH
            tone += c[s.BLADES] * sharp * value_noise.py_func(ground.lattice, across, along)[0]
    if c[s.RIPPLES] > 0.02 and footprint < s.RIPPLE_LENGTH / 2:
        details.add("ripples")
        sharp = min(s.RIPPLE_LENGTH / (2 * footprint) - 1, 1.0)
        along = (0.8 * x + 0.6 * y) / s.RIPPLE_LENGTH + 4.0 * n[9] + 2.5 * n[8] + 1.2 * n[7] + 0.5 * n[6]
        relief += c[s.RIPPLES] * sharp * np.cos(2 * np.pi * along) * (1 + n[6])
    off = (c[s.TRAIL] * s.TRAIL_REACH - s.TRACK_OFFSET + 0.05 * wander_x) / s.TRACK_WIDTH
    track = max(1 - 0.3 * off * off, 0.0) ** 2 * min(s.TRACK_WIDTH / footprint, 1.0)
    details |= {"track"} if track else set()
    tone, relief = tone * (1 - 0.5 * track) - 0.10 * track, relief * (1 - 0.6 * track)

    sun = c[s.SUN] * shadow * np.clip(1 + relief, 0.15, 2.0) * (1 + 0.25 * phase)
    gloss = c[s.GLOSS] * (0.02 + 0.98 * (1 - facing) ** 5)
    lit = colour * max(1 + tone, 0.25) * (sun * light.sun_colour + light.sky_colour)
    seen = lit + gloss * (light.horizon_colour - lit)
    clear = np.exp(-light.haze * distance)
    return light.horizon_colour + clear * (seen - light.horizon_colour), details


def random_ground(rng):
    """Ground whose channels change slowly, each from nothing to everything."""
    node = np.arange(41)
    wave = rng.uniform(0.1, 0.5, (2, s.CHANNELS)), rng.uniform(0, 6, s.CHANNELS)
    nodes = 127.5 + 180 * np.sin(wave[0][0] * node[:, None, None] + wave[0][1] * node[:, None] + wave[1])
    return s.GroundTexture(
        nodes=np.clip(nodes, 0, 255).astype(np.uint8),
        x0=-5.0,
        y0=-5.0,
        resolution=0.25,
        elevation=np.zeros((41, 41), np.float32),
        lattice=random_lattice(rng),
        turn=octave_turns(rng),
        sun=rng.normal(size=(OCTAVES, 2)).astype(np.float32),
        soil=np.array((0.2, 0.14, 0.09), np.float32),
        plants=np.zeros((4, 3), np.float32),
    )


# One place, less than a batch, a full batch, and several.
@pytest.mark.parametrize("n", [1, 60, s.TOGETHER, 700])
def test_many_places_together_look_as_each_alone(n):
    rng = np.random.default_rng(n)
    ground, light = random_ground(rng), draw_light(rng, 1.0)
    box = np.array([[[-1.0, -1, 0], [1, 1, 1]]] * 2)
    vehicle = s.Vehicle(np.array([0.3, 0.1, 0.2]), np.eye(3), light.sun + 1e-9, box, np.zeros((1, 3)))
    # From near places that show all details to far ones that show none, the latter beyond the border, too.
    distance = rng.choice((0.8, 2.0, 6.0, 20.0), n).astype(np.float32)
    down = rng.uniform(0.1, 1.0, n)
    azimuth = rng.uniform(0, 2 * np.pi, n)
    flat = np.sqrt(1 - down**2)
    rays = np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), -down), axis=1).astype(np.float32)
    normal = np.array((0.1, -0.05, 0.99)) + rng.normal(0, 0.1, (n, 3))
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
    surface = np.where(rng.random(n) < 0.8, s.GROUND, s.SKY).astype(np.int8)
    surface[0] = s.GROUND
    origin, out = np.array([0.5, -0.4, 1.4]), np.full((n, 3), np.nan, np.float32)
    hits = (distance, surface, np.zeros(n, np.int32), normal)
    s.shade_rays(ground, light, vehicle, PIXEL, origin, rays, *hits, s.shading_buffers(OCTAVES), out)

    shown: list[str] = []
    errors = []
    for r in np.flatnonzero(surface == s.GROUND):
        facing = max(-float(rays[r] @ normal[r]), 0.02)
        x, y, z = origin + distance[r] * rays[r].astype(float)
        footprint = max(distance[r] * PIXEL / np.sqrt(facing), 1e-4)
        shadow = s.sunlit(vehicle, x, y, z)
        look = (facing, -float(rays[r] @ light.sun), footprint, shadow)
        expected, details = one_ground(ground, light, x, y, *look, float(distance[r]))
        errors.append(np.abs(out[r] - expected).max())
        shown += [*details, "shadow" if shadow == 0 else "sun"]
    assert np.isfinite(out).all()
    # Places are rounded by micrometres where stones begin and octaves of the noise are steep.
    assert np.median(errors) < 1e-5
    assert np.quantile(errors, 0.98) < 2e-3
    if n > s.TOGETHER:
        every = {"stones", "grass", "blades", "ripples", "track", "shadow", "sun"}
        assert {name for name in every if shown.count(name) > 5} == every
        assert all(shown.count(name) < len(errors) for name in every)
