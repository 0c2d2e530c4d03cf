"""Textures and shading of the ground in vectors, against a plain reference of one place."""

import numpy as np
import pytest

from offpiste.simulation.rendering import shading as s
from offpiste.simulation.rendering.appearance import draw_light
from offpiste.simulation.rendering.scene import SURFACES, Hits
from offpiste.simulation.rendering.shading import OCTAVES, octave_turns, random_lattice
from offpiste.simulation.world.grids import read_grid

SKY, GROUND, TRUNK, CROWN, BUSH, GRASS, BODY = range(len(SURFACES))
STONE_SIZE, BLADE_WIDTH, BLADE_LENGTH, RIPPLE_LENGTH = 0.05, 0.012, 0.09, 0.13
TRACK_OFFSET, TRACK_WIDTH, RAGGED = 0.66, 0.17, 0.12


def value_noise(lattice, x, y):
    """Noise at one place, and its slopes."""
    i, j = (int(np.floor(place)) % s.PERIOD for place in (x, y))
    offsets, corners = np.array((x % 1, y % 1)), lattice[j : j + 2, i : i + 2]
    share, slope = offsets**2 * (3 - 2 * offsets), 6 * offsets * (1 - offsets)
    along, across = np.stack((1 - share, share), axis=1)
    steep_along, steep_across = np.stack((-slope, slope), axis=1)
    return across @ corners @ along, across @ corners @ steep_along, steep_across @ corners @ along


def pebbles(lattice, x, y):
    """Brightness of stones at one place: the nearest of four."""
    left, low = int(np.floor(x - 0.5)), int(np.floor(y - 0.5))
    found = []
    for column, row in [(left, low), (left + 1, low), (left, low + 1), (left + 1, low + 1)]:
        i, j = column % s.PERIOD, row % s.PERIOD
        off = x - column - 0.5 - 0.42 * lattice[j, i], y - row - 0.5 - 0.42 * lattice[i, j]
        found.append((off[0] ** 2 + off[1] ** 2, lattice[(j + 64) % s.PERIOD, i]))
    distance, tone = min(found)
    return 0.5 * tone + 0.45 - distance if distance < 0.16 + 0.10 * tone else -0.3


def sunlit(vehicle, place):
    """0 in the shadow of the vehicle's boxes, else 1."""
    from_vehicle = vehicle.rotation.T @ (place - vehicle.position)
    ends = np.sort((vehicle.shadow - from_vehicle) / vehicle.sun, axis=1)
    return float(not (np.maximum(ends[:, 0].max(axis=1), 0) < ends[:, 1].min(axis=1))[1:].any())


def one_place(lattice, turn, sun, x, y, finest):
    """The plain reference: octaves of one place, one after the other."""
    value, slope = np.zeros(OCTAVES), np.zeros(OCTAVES)
    for o, (cos, sin) in enumerate(turn.astype(float)):
        fade = min(finest / np.hypot(cos, sin) - 1, 1)
        if fade > 0:
            result, slope_x, slope_y = value_noise(lattice, cos * x + sin * y + o * 17, cos * y - sin * x + o * 29)
            value[o], slope[o] = fade * result, -fade * (slope_x * sun[o, 0] + slope_y * sun[o, 1])
    return value, slope


PIXEL = 1 / 530.0


def one_ground(ground, light, x, y, facing, phase, footprint, shadow, distance):
    """The plain reference: colour of one place on the ground, and which details it shows."""
    n, slope = one_place(ground.lattice, ground.turn, ground.sun, x, y, 0.5 / footprint)
    wander_x, wander_y = n[6] + 0.5 * n[4], n[5] - 0.5 * n[3]
    place = np.array([[x + RAGGED * wander_x, y + RAGGED * wander_y]])
    c = read_grid(ground.nodes, (ground.x0, ground.y0), ground.resolution, place)[0] / 255

    hue = np.clip(0.5 + 0.35 * (n[9] - n[8] + n[7] - n[6] + n[5]), 0, 1)
    colour = (c[s.LOW : s.LOW + 3] + hue * (c[s.HIGH : s.HIGH + 3] - c[s.LOW : s.LOW + 3])) ** 2
    middle = n[3:6].sum()
    tone = s.MOST_RELIEF * (c[s.FINE] * (n[:3].sum() + 0.5 * middle) + c[s.COARSE] * (n[6:].sum() + 0.5 * middle))
    relief = s.MOST_RELIEF * c[s.BUMPS] * slope[:6].sum()
    details = set()
    if c[s.STONES] > 0.02 and footprint < STONE_SIZE / 2:
        details.add("stones")
        sharp = min(STONE_SIZE / (2 * footprint) - 1, 1.0)
        stone = pebbles(ground.lattice, x / STONE_SIZE + 0.25 * n[2], y / STONE_SIZE + 0.25 * n[1])
        tone += c[s.STONES] * sharp * stone
    if c[s.BLADES] > 0.02:
        details.add("grass")
        colour += np.exp(-3 * c[s.BLADES] / facing) * (ground.soil - colour)
        if footprint < 2 * BLADE_WIDTH:
            details.add("blades")
            sharp = min(2 * BLADE_WIDTH / footprint - 1, 1.0)
            cos, sin = np.cos(3.0 * n[8] + 1.5 * n[6]), np.sin(3.0 * n[8] + 1.5 * n[6])
            across, along = (cos * x + sin * y) / BLADE_WIDTH, (cos * y - sin * x) / BLADE_LENGTH
            tone += c[s.BLADES] * sharp * value_noise(ground.lattice, across, along)[0]
    if c[s.RIPPLES] > 0.02 and footprint < RIPPLE_LENGTH / 2:
        details.add("ripples")
        sharp = min(RIPPLE_LENGTH / (2 * footprint) - 1, 1.0)
        along = (0.8 * x + 0.6 * y) / RIPPLE_LENGTH + 4.0 * n[9] + 2.5 * n[8] + 1.2 * n[7] + 0.5 * n[6]
        relief += c[s.RIPPLES] * sharp * np.cos(2 * np.pi * along) * (1 + n[6])
    off = (c[s.TRAIL] * s.TRAIL_REACH - TRACK_OFFSET + 0.05 * wander_x) / TRACK_WIDTH
    track = max(1 - 0.3 * off * off, 0.0) ** 2 * min(TRACK_WIDTH / footprint, 1.0)
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


def random_rays(rng, n):
    """Arguments of `shade_rays`: rays that meet ground and sky, from near places that show all details to far ones."""
    ground, light = random_ground(rng), draw_light(rng, 1.0)
    box = np.array([[[-1.0, -1, 0], [1, 1, 1]]] * 2)
    vehicle = s.Vehicle(np.array([0.3, 0.1, 0.2]), np.eye(3), light.sun + 1e-9, box, np.full((2, 3), 0.3))
    # The farthest places lie beyond the border.
    distance = rng.choice((0.8, 2.0, 6.0, 20.0), n).astype(np.float32)
    down = rng.uniform(0.1, 1.0, n)
    azimuth = rng.uniform(0, 2 * np.pi, n)
    flat = np.sqrt(1 - down**2)
    rays = np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), -down), axis=1).astype(np.float32)
    normal = np.array((0.1, -0.05, 0.99)) + rng.normal(0, 0.1, (n, 3))
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
    surface = np.where(rng.random(n) < 0.8, GROUND, SKY).astype(np.int8)
    surface[:1] = GROUND
    hits = Hits(distance, surface, np.zeros(n, np.int32), normal)
    return ground, light, vehicle, PIXEL, np.array([0.5, -0.4, 1.4]), rays, hits


# One place, fewer than a vector has lanes, and many.
@pytest.mark.parametrize("n", [1, 13, 700])
def test_many_places_together_look_as_each_alone(n):
    rng = np.random.default_rng(n)
    ground, light, vehicle, _, origin, rays, hits = arguments = random_rays(rng, n)
    distance, surface, normal = hits.distance, hits.surface, hits.normal
    place, mixed = rng.permutation(n).astype(np.int32), np.full((n, 3), np.nan, np.float32)
    s.shade_rays(*arguments, place, mixed)
    out = mixed[place]

    shown: list[str] = []
    errors = []
    for r in np.flatnonzero(surface == GROUND):
        facing = max(-float(rays[r] @ normal[r]), 0.02)
        at = origin + distance[r] * rays[r].astype(float)
        footprint = max(distance[r] * PIXEL / np.sqrt(facing), 1e-4)
        shadow = sunlit(vehicle, at)
        look = (facing, -float(rays[r] @ light.sun), footprint, shadow)
        expected, details = one_ground(ground, light, *at[:2], *look, float(distance[r]))
        errors.append(np.abs(out[r] - expected).max())
        shown += [*details, "shadow" if shadow == 0 else "sun"]
    assert np.isfinite(out).all()
    # Places are rounded by micrometres where stones begin and octaves of the noise are steep.
    assert np.median(errors) < 1e-5
    assert np.quantile(errors, 0.98) < 2e-3
    if n > 100:
        every = {"stones", "grass", "blades", "ripples", "track", "shadow", "sun"}
        assert {name for name in every if shown.count(name) > 5} == every
        assert all(shown.count(name) < len(errors) for name in every)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_what_is_no_hit_stays_inside_the_arrays(bad):
    rng = np.random.default_rng(3)
    *scene, origin, rays, hits = random_rays(rng, 300)
    surface = rng.integers(-128, 127, 300).astype(np.int8)
    surface[:100] = np.arange(100) % len(SURFACES)
    item = rng.integers(-(2**31), 2**31, 300).astype(np.int32)
    places, out = np.arange(300, dtype=np.int32), np.zeros((300, 3), np.float32)
    for name, array in (("rays", rays), ("distance", hits.distance), ("normal", hits.normal)):
        bent = {"rays": rays, "distance": hits.distance, "normal": hits.normal} | {name: np.full_like(array, bad)}
        wrong = Hits(bent["distance"], surface, item, bent["normal"])
        s.shade_rays(*scene, origin, bent["rays"], wrong, places, out)
    s.shade_rays(*scene, np.full(3, bad), rays, hits, places, out)


def test_wrong_shapes_and_places_are_refused():
    *scene, rays, hits = random_rays(np.random.default_rng(4), 20)
    place, out = np.arange(20, dtype=np.int32), np.zeros((20, 3), np.float32)
    ground = scene[0]._replace(lattice=scene[0].lattice[1:])
    for arguments in (
        (*scene, rays, hits.part(slice(1, None)), place, out),
        (*scene, rays, hits, place + 1, out),
        (*scene, rays, hits, place - 1, out),
        (ground, *scene[1:], rays, hits, place, out),
    ):
        with pytest.raises(ValueError, match=r"shapes|places"):
            s.shade_rays(*arguments)
